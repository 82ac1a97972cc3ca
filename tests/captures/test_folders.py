"""Data sets are found near the folder that was named, whatever else lies there."""

from jghand_engine.captures.reading import find_roots


def test_a_folder_that_cannot_be_looked_into_hides_no_data_set(tmp_path):
    for name in ("lost+found", "set"):
        (tmp_path / name).mkdir()

    def is_root(folder):
        if folder.name == "lost+found":
            raise PermissionError(13, "Permission denied", str(folder))
        return folder.name == "set"

    assert find_roots(tmp_path, is_root) == [tmp_path / "set"]
