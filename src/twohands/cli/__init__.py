"""The command line: `twohands VERB ...`, one module per verb."""
