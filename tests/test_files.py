import pytest

from bodylog.errors import UsageError
from bodylog.files import replacing, sha256


def test_success_replaces_and_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "out.bin"
    with replacing(path) as beside:
        beside.write_bytes(b"first")
    with pytest.raises(RuntimeError), replacing(path) as beside:
        beside.write_bytes(b"second")
        raise RuntimeError
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_absent_folder_says_what_to_type(tmp_path):
    with pytest.raises(UsageError, match="mkdir -p"), replacing(tmp_path / "no" / "out.bin"):
        pass


def test_digest_of_a_folder_is_of_its_files_in_name_order(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "b").write_bytes(b"2")
    (folder / "a").write_bytes(b"1")
    (tmp_path / "both").write_bytes(b"12")
    assert sha256(folder) == sha256(tmp_path / "both")


def test_a_folder_is_not_a_file_to_write(tmp_path):
    with pytest.raises(UsageError, match="is a folder"), replacing(tmp_path):
        pass
