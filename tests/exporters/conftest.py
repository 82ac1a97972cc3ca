"""What the tests of exports share."""

from __future__ import annotations

import pytest


@pytest.fixture
def no_usd_warnings():
    """Any warning of USD fails the test: a dropped relationship is only ever warned about."""
    from pxr import UsdUtils

    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    yield
    warnings = [item.commentary for item in delegate.TakeUncoalescedDiagnostics()]
    assert not warnings
