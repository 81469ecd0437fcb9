"""The page's address with its control token: said to a person at a terminal, else kept in a file of this user only."""

import re
import sys

import pytest

from gateway_fdi.errors import InputError
from gateway_serve import server
from gateway_serve.cli.serve import serve as command
from gateway_serve.server import ServeSettings, kept_address

ADDRESS = "http://127.0.0.1:8808/#control=secret"


@pytest.fixture
def said(tmp_path, monkeypatch, capsys):
    """Return what the command says, at a terminal or not, and what its file has while the page is served."""

    def start(*, terminal):
        file, seen = tmp_path / "status.page", []
        monkeypatch.setattr(server, "serve", lambda *_: seen.append(file.read_text() if file.exists() else None))
        monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
        options = dict.fromkeys(("read_token_file", "control_token_file", "certificate", "key", "parent"))
        place = {"status": tmp_path / "status", "host": "127.0.0.1", "port": 0, "names": (), "open_page": False}
        assert command(None, **place, **options) == 0
        assert not file.exists(), "it goes with the page"
        return capsys.readouterr().err, seen[0]

    return start


def test_a_person_at_a_terminal_reads_the_address_with_the_token(said):
    line, kept = said(terminal=True)
    assert re.fullmatch(r"page: http://127.0.0.1:\d+/#control=\S{30,}\n", line)
    assert kept is None


@pytest.mark.evidence("Releases: page token")
def test_a_journal_has_the_place_of_the_token_and_not_the_token(said, tmp_path):
    line, kept = said(terminal=False)
    url, file = re.fullmatch(r"page: (\S+) \(with the control token: (.+)\)\n", line).groups()
    assert file == str(tmp_path / "status.page")
    assert kept.startswith(f"{url}#control=")
    assert "#" not in line


def test_the_file_is_its_users_alone_and_no_link_is_followed(tmp_path):
    settings = ServeSettings(tmp_path / "status")
    other = tmp_path / "other"
    other.write_text("others read this")
    (tmp_path / "status.page").symlink_to(other)
    with kept_address(settings, ADDRESS) as file:
        assert file.read_text() == f"{ADDRESS}\n"
        assert not file.is_symlink()
        assert sys.platform == "win32" or file.stat().st_mode & 0o777 == 0o600
    assert other.read_text() == "others read this"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["other"]


def test_a_page_takes_only_its_own_file_away(tmp_path):
    settings = ServeSettings(tmp_path / "status")
    with kept_address(settings, ADDRESS) as file, kept_address(settings, f"{ADDRESS}2"):
        pass
    assert not file.exists()
    with kept_address(settings, ADDRESS) as file:
        file.write_text("http://127.0.0.1:1/#control=another\n")
    assert file.exists()


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "status.page").mkdir()
    (tmp_path / "status.page" / "full").touch()
    with pytest.raises(InputError, match="--control-token-file"), kept_address(ServeSettings(tmp_path / "status"), ""):
        pass
    assert [each.name for each in tmp_path.iterdir()] == ["status.page"], "nothing of it is left"
