"""Checkpoints: every bit comes back, a kill leaves a whole one, and damage is named."""

import pytest
import safetensors.torch
import torch
from stand_in import StandIn

from jghand_engine.errors import InputError
from jghand_engine.learn.checkpoint import (
    METADATA_KEY,
    CheckpointFolder,
    LoopState,
    Snapshot,
    check_fits,
    load_checkpoint,
    save_checkpoint,
)

STAMP = {"seed": 0, "rate": 1e-3, "range": (1, 2)}


@pytest.fixture
def snapshot():
    model = StandIn()
    for number in range(3):
        model.step(number)
    state = LoopState(step=3, planned_steps=9, seconds=0.1, skipped=[1], sums={"loss": 0.1 + 0.2}, summed=3)
    return Snapshot.of(model, state)


def test_every_bit_comes_back(snapshot, tmp_path):
    path = tmp_path / "a.safetensors"
    save_checkpoint(path, snapshot, STAMP)
    loaded, stamp = load_checkpoint(path)
    assert loaded.scalars == snapshot.scalars
    assert loaded.state == snapshot.state
    assert stamp == {"seed": 0, "rate": 1e-3, "range": [1, 2]}
    assert loaded.tensors.keys() == snapshot.tensors.keys()
    assert all(torch.equal(loaded.tensors[name], tensor) for name, tensor in snapshot.tensors.items())


def test_a_snapshot_does_not_change_when_the_training_goes_on(snapshot):
    model = StandIn()
    state = snapshot.restore(model)
    kept = Snapshot.of(model, state)
    model.step(3)
    state.skipped.append(7)
    assert kept.state.skipped == [1]
    assert all(torch.equal(kept.tensors[name], tensor) for name, tensor in snapshot.tensors.items())


def test_options_that_json_writes_otherwise_still_agree(snapshot, tmp_path):
    folder = CheckpointFolder(tmp_path, STAMP)
    folder.save(snapshot)
    found, damaged = folder.newest()
    assert found is not None
    assert not damaged


# ---- damage ----------------------------------------------------------------------------------------------------------


def written(tmp_path, metadata):
    path = tmp_path / "bad.safetensors"
    path.write_bytes(safetensors.torch.save({"a": torch.zeros(2)}, metadata))
    return path


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        (None, "wanted a checkpoint"),
        ({METADATA_KEY: "[1, 2"}, "wanted a checkpoint"),
        ({METADATA_KEY: "[1]"}, "wanted a checkpoint"),
        ({METADATA_KEY: '{"format_version": 1, "jghand_version": "0.1.0"}'}, "JGHand 0.1.0"),
        ({METADATA_KEY: '{"format_version": 4, "jghand_version": "0.1.0", "stamp": {}}'}, "Resume with JGHand 0.1.0"),
        ({METADATA_KEY: '{"format_version": 5, "stamp": {}, "scalars": {}, "state": {"steps": 1}}'}, "steps"),
    ],
)
def test_a_file_that_is_no_checkpoint_is_named(metadata, said, tmp_path):
    with pytest.raises(InputError, match=said) as caught:
        load_checkpoint(written(tmp_path, metadata))
    assert "bad.safetensors" in str(caught.value)


def test_a_checkpoint_cut_anywhere_is_refused(snapshot, tmp_path):
    path = tmp_path / "cut.safetensors"
    save_checkpoint(path, snapshot, STAMP)
    whole = path.read_bytes()
    for length in range(0, len(whole), 397):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError):
            load_checkpoint(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda tensors: tensors.pop("first.log_sigma"), "first.log_sigma.*got none"),
        (lambda tensors: tensors.update(more=torch.zeros(1)), "more: wanted none"),
        (lambda tensors: tensors.update({"first.log_sigma": torch.zeros(6)}), r"float32 \(6, 6\), got float32 \(6,\)"),
        (lambda tensors: tensors.update({"first.log_sigma": torch.zeros(6, 6).double()}), "got float64"),
    ],
)
def test_tensors_of_another_model_are_named(change, said, snapshot):
    tensors = dict(snapshot.tensors)
    change(tensors)
    with pytest.raises(InputError, match=said):
        check_fits(tensors, StandIn(), "the checkpoint")


def test_an_option_that_an_older_jghand_did_not_know_was_off(tmp_path, snapshot):
    save_checkpoint(tmp_path / "step_00000003.safetensors", snapshot, STAMP)
    found, damaged = CheckpointFolder(tmp_path, {**STAMP, "known_light": False}).newest()
    assert found is not None
    assert not damaged
    with pytest.raises(InputError, match="known_light"):
        CheckpointFolder(tmp_path, {**STAMP, "known_light": True}).newest()
