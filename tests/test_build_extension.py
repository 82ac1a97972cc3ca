"""The zip of the extension: what is in it, that it is the same every time, and what is refused."""

import json
import shutil
import zipfile
from pathlib import Path

import build_extension
import pytest
from build_extension import ROOT, BuildError


@pytest.fixture
def source(tmp_path) -> Path:
    """A copy of the extension's folder that a test may spoil."""
    folder = tmp_path / "blender_addon"
    shutil.copytree(build_extension.SOURCE, folder, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def names(archive: Path) -> list[str]:
    with zipfile.ZipFile(archive) as content:
        return content.namelist()


def test_the_zip_holds_the_extension_the_protocol_and_the_licenses(tmp_path):
    archive = build_extension.build(tmp_path)
    assert archive.name == "jghand-0.1.0.zip"
    assert {"__init__.py", "blender_manifest.toml", "LICENSE", "LICENSE-MIT", "NOTICE"} <= set(names(archive))
    with zipfile.ZipFile(archive) as content:
        for name in ("service/protocol.py", "motion/conventions.py"):
            assert content.read(f"core/{Path(name).name}") == (ROOT / "jghand_engine" / name).read_bytes()
        assert content.testzip() is None
        assert not [entry.filename for entry in content.infolist() if entry.external_attr >> 16 & 0o111]


def test_no_test_no_compiled_file_and_nothing_of_the_engine_is_in_the_zip(tmp_path):
    found = names(build_extension.build(tmp_path))
    assert not [name for name in found if "test" in name or "__pycache__" in name or name.endswith((".pyc", ".so"))]
    assert not [name for name in found if name.startswith(("jghand_engine", "blender_addon"))]


def test_the_same_files_give_the_same_bytes(tmp_path, source):
    for path in source.rglob("*.py"):
        path.touch()  # another time, and an order of the folder that may be another too
        path.chmod(0o755)
    first, second = build_extension.build(tmp_path / "a"), build_extension.build(tmp_path / "b", source)
    assert first.read_bytes() == second.read_bytes()


def test_a_file_that_nobody_expects_is_refused_by_name(tmp_path, source):
    (source / "core" / "engine.log").write_text("left by somebody")
    with pytest.raises(BuildError, match=r"engine\.log is of no kind"):
        build_extension.build(tmp_path, source)
    assert not list(tmp_path.glob("*.zip"))


def test_the_repository_that_blenders_tool_writes_names_the_zip(tmp_path):
    tool = build_extension.find_tool()
    if tool is None:
        pytest.skip("Blender's tool for extensions comes with .envs/blender, which is not made")
    archive = build_extension.build(tmp_path)
    build_extension.check_and_index(tool, [archive])
    (listed,) = json.loads((tmp_path / "index.json").read_text())["data"]
    assert (listed["id"], listed["archive_url"]) == ("jghand", f"./{archive.name}")
    assert listed["archive_size"] == archive.stat().st_size
    assert "repository=" in (tmp_path / "index.html").read_text()


def test_what_blenders_tool_refuses_is_refused_with_its_words(tmp_path, source):
    tool = build_extension.find_tool()
    if tool is None:
        pytest.skip("Blender's tool for extensions comes with .envs/blender, which is not made")
    manifest = source / "blender_manifest.toml"
    text = manifest.read_text().replace('joints"\nmaintainer', 'joints."\nmaintainer')
    manifest.write_text(text)
    with pytest.raises(BuildError, match="punctuation"):
        build_extension.check_and_index(tool, [build_extension.build(tmp_path, source)])
