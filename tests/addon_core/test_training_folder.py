"""The folder of a training is read while it is written, and whatever lies in it."""

from __future__ import annotations

from blender_addon.train.training_folder import TrainingFolder, folder_of


def test_a_folder_without_a_training_has_none(tmp_path):
    seen = TrainingFolder.look(tmp_path / "none")
    assert not seen.can_go_on
    assert (seen.steps, seen.picture, seen.avatar) == (0, None, None)


def test_steps_previews_and_the_avatar_are_found(tmp_path):
    (tmp_path / "training.json").write_text("{}")
    for folder, suffix in (("pictures", "png"), ("checkpoints", "safetensors")):
        (tmp_path / folder).mkdir()
        for step in (0, 500):
            (tmp_path / folder / f"step_{step:08d}.{suffix}").write_bytes(b"")
    (tmp_path / "preview.jghand").write_bytes(b"")
    seen = TrainingFolder.look(tmp_path)
    assert seen.can_go_on
    assert seen.avatar is not None
    assert seen.picture is not None
    assert seen.picture.name == "step_00000500.png"
    assert seen.sentence() == "500 steps"


def test_the_work_of_a_training_lies_beside_its_avatar(tmp_path):
    assert folder_of(tmp_path / "id3.jghand").name == "id3.training"
