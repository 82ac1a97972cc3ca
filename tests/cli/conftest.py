"""What the tests of the command line share."""

from quick_builtin import quick_builtin  # noqa: F401
