"""What the tests of exports share."""

import pytest


@pytest.fixture(scope="module")
def no_usd_warnings():
    """Any warning of USD in a module fails it, those of fixtures that are made once for it too: a dropped relationship
    is only ever warned about."""
    from pxr import UsdUtils

    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    yield
    warnings = [item.commentary for item in delegate.TakeUncoalescedDiagnostics()]
    assert not warnings
