"""What the tests of drawing share."""

from native_variants import library  # noqa: F401
