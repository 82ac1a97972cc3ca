"""Independent programs find in our splat files what the engine has, within the format's own precision.

They are put into .envs/splat_clients by `scripts/check_splat_files.py --install`, never by the tests; without them
these tests are skipped.
"""

import json

import check_splat_files
import numpy as np
import pytest
import show_splat_file
from check_splat_files import CLIENTS, SUBJECTS, Client, Difference, Found, clients

from jghand_engine.errors import InputError
from jghand_engine.export.splats.files import FORMATS, SplatMotion

PAIRS = [(client, format) for client in clients() for format in client.formats]


def content(format: str, subject: str) -> tuple[bytes, Found]:
    try:
        FORMATS[format].check()
    except InputError as error:
        pytest.skip(str(error))
    cloud = SUBJECTS[subject](FORMATS[format].axes[0])
    return FORMATS[format].encode(cloud), Found.of_cloud(cloud)


def wants(client: Client) -> None:
    if not client.there():
        pytest.skip(f"{client.name} is not in {CLIENTS.name} (scripts/check_splat_files.py --install)")


@pytest.mark.parametrize("subject", SUBJECTS)
@pytest.mark.parametrize(("client", "format"), PAIRS, ids=[f"{client.name}-{format}" for client, format in PAIRS])
def test_a_program_finds_what_the_engine_has(tmp_path, client, format, subject):
    wants(client)
    written, wanted = content(format, subject)
    path = tmp_path / f"hand.{format}"
    path.write_bytes(written)
    difference = Difference.between(client.find(path, wanted), wanted)
    assert difference.within(client.limit(format)), difference


def test_gaussians_that_are_lacking_or_there_twice_are_no_match_in_any_order():
    wanted = Found.of_cloud(SUBJECTS["ellipsoids"]("rdf"))
    count = len(wanted.positions_m)

    def difference(rows: np.ndarray) -> Difference:
        found = Found(*(getattr(wanted, name)[rows] for name in wanted.__dataclass_fields__))
        return Difference.between(found.in_order_of(wanted), wanted)

    shuffled = np.random.default_rng(5).permutation(count)
    assert difference(shuffled) == check_splat_files.NOTHING
    for wrong in (np.tile(shuffled, 2), shuffled[1:], np.append(shuffled[1:], shuffled[1])):
        assert difference(wrong).position_mm > 1


def test_the_programs_and_all_that_they_need_are_pinned_with_their_hashes():
    wanted = json.loads((check_splat_files.TOOLS / "package.json").read_text())["dependencies"]
    lock = json.loads((check_splat_files.TOOLS / "package-lock.json").read_text())["packages"]
    assert lock[""]["dependencies"] == wanted
    assert {name: lock[f"node_modules/{name}"]["version"] for name in wanted} == wanted
    assert all("integrity" in about for name, about in lock.items() if name)


def test_every_format_is_read_by_at_least_three_programs():
    for format in FORMATS:
        assert len({client.name for client, one in PAIRS if one == format}) >= 3


def test_khronos_validator_finds_nothing_but_the_extension_that_it_does_not_know(tmp_path):
    if not check_splat_files.node_has("gltf-validator")():
        pytest.skip("gltf-validator is not there (scripts/check_splat_files.py --install)")
    path = tmp_path / "hand.glb"
    path.write_bytes(content("glb", "ellipsoids")[0])
    issues = json.loads(check_splat_files.node("validate_glb.mjs", path))["messages"]
    known = [issue for issue in issues if "KHR_gaussian_splatting" in issue["message"] + issue["pointer"]]
    assert issues == known
    assert {issue["code"] for issue in known} <= {"UNSUPPORTED_EXTENSION", "MESH_PRIMITIVE_INVALID_ATTRIBUTE"}


def test_another_renderer_draws_our_picture_of_a_ply_file(tmp_path):
    packages = ("@sparkjsdev/spark", "playwright-core", "three")
    if not all(check_splat_files.node_has(package)() for package in packages):
        pytest.skip("Spark is not there (scripts/check_splat_files.py --install)")
    if show_splat_file.browser() is None:
        pytest.skip("there is no Chromium (JGHAND_CHROMIUM names one)")
    avatar, sequence, camera = show_splat_file.posed("builtin", "point")
    path = tmp_path / "hand.ply"
    path.write_bytes(FORMATS["ply"].encode(SplatMotion(avatar, sequence, axes="rdf").cloud(0)))
    theirs = show_splat_file.drawn_by_spark(path, camera, show_splat_file.AS_LEARNED)
    ours = show_splat_file.drawn_by_us(SplatMotion(avatar, sequence, axes="rub").cloud(0), camera)
    # seen 54.0 dB
    assert show_splat_file.psnr_db(ours, theirs) > 53
