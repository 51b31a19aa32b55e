"""The pipeline taken apart: truth in place of stages, error budgets, settings compared, time by stage."""
