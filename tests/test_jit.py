"""The cache of compiled kernels."""

from gateway import jit


def test_old_caches_go_and_one_that_another_process_deletes_is_no_error(tmp_path, monkeypatch):
    for name in ("kernels-a", "kernels-b", "kernels-c", "kernels-own"):
        (tmp_path / name).mkdir()
    (tmp_path / "kernels-gone").symlink_to(tmp_path / "nothing")  # as if deleted just now
    monkeypatch.setattr(jit, "CACHE", tmp_path / "kernels-own")
    jit.prune_cache(keep=2)
    left = {path.name for path in tmp_path.glob("kernels-*") if path.exists()}
    assert "kernels-own" in left
    assert len(left) == 2
