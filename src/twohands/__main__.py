"""`python -m twohands` is `twohands`."""

import sys

from twohands.cli.main import main

sys.exit(main())
