"""NVIDIA's validator finds nothing in our stages, and readers that share nothing with Pixar's find what the engine has.

They are put into .envs/usd_clients by `scripts/check_usd_files.py --install`, never by the tests; without them these
tests are skipped.
"""

import check_usd_files
import pytest
from check_usd_files import WAYS, Way
from other_programs import python_of


@pytest.fixture(autouse=True)
def clients():
    if not python_of(check_usd_files.CLIENTS).exists():
        pytest.skip(f"{check_usd_files.CLIENTS.name} is not here (scripts/check_usd_files.py --install)")


# the long take is what the script is for
@pytest.mark.parametrize("way", [way for way in WAYS if way.frames < 100], ids=lambda way: way.words or "layers")
def test_a_stage_passes_and_is_read(tmp_path, way: Way, no_usd_warnings):
    report = check_usd_files.write(way, tmp_path)
    verdict = check_usd_files.judge(way, report)
    assert verdict.good, verdict
    for reading in check_usd_files.readings(way, report):
        assert reading.good, reading


def test_splats_that_are_broken_are_found_by_nvidias_rule(tmp_path):
    """Else it would prove nothing that it finds nothing."""
    from pxr import Usd

    report = check_usd_files.write(WAYS[0], tmp_path)
    stage = Usd.Stage.Open(str(tmp_path / "hand.splats.usdc"))
    stage.GetPrimAtPath("/Splats").RemoveProperty("opacities")
    stage.Save()
    del stage
    verdict = check_usd_files.judge(WAYS[0], report)
    assert verdict.splats
    assert not verdict.good
