"""What the tests of avatars share."""

from native_variants import library  # noqa: F401
