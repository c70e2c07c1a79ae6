"""Measured data: where they are looked for, what is checked, and what is said when they cannot be had."""

from __future__ import annotations

import hashlib
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from zoo.blood.fetch import FILES, FetchError, fetch_dataset, fetch_file

CONTENT = b"1.0\n2.0\n" * 50_000
DIGEST = hashlib.sha256(CONTENT).hexdigest()


class Server:
    """A web server on this machine; `files` may change, and `asked` lists what was asked for."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.asked: list[str] = []
        owner = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                owner.asked.append(self.path)
                content = owner.files.get(self.path.lstrip("/"))
                self.send_response(404 if content is None else 200)
                self.send_header("Content-Length", str(len(content or b"")))
                self.end_headers()
                self.wfile.write(content or b"")

            def log_message(self, *args: object) -> None:
                pass

        self.http = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_port}/"
        threading.Thread(target=self.http.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        self.http.shutdown()
        self.http.server_close()


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Server]:
    """A data set "toy" of two equal files that only the server has, and an empty cache."""
    server = Server()
    server.files = {"a.dat": CONTENT, "b.dat": CONTENT}
    for name in server.files:
        monkeypatch.setitem(FILES, f"toy/{name}", (server.url, DIGEST))
    monkeypatch.setattr("pooch.os_cache", lambda project: tmp_path / "cache" / project)
    monkeypatch.delenv("ZOO_DATA_DIR", raising=False)
    for name in ("http_proxy", "https_proxy", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    yield server
    server.close()


def fails(name: str, message: str) -> str:
    with pytest.raises(FetchError, match=message) as error:
        fetch_file(name)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_downloaded_once(server: Server, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = fetch_file("toy/a.dat")
    assert path == tmp_path / "cache" / "zoo" / "toy" / "a.dat"
    assert path.read_bytes() == CONTENT
    assert fetch_file("toy/a.dat") == path
    assert server.asked == ["/a.dat"]
    assert capfd.readouterr() == ("", "")
    assert fetch_dataset("toy") == (path, path.with_name("b.dat"))
    assert server.asked == ["/a.dat", "/b.dat"]


def test_a_damaged_cache_is_downloaded_again(server: Server) -> None:
    path = fetch_file("toy/a.dat")
    path.write_bytes(b"damaged")
    assert fetch_file("toy/a.dat").read_bytes() == CONTENT
    assert len(server.asked) == 2


@pytest.mark.parametrize("place", ["toy/a.dat", "a.dat"])
def test_the_data_folder_comes_first_and_a_wrong_file_in_it_is_named(
    server: Server, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "data" / place
    path.parent.mkdir(parents=True)
    path.write_bytes(CONTENT)
    monkeypatch.setenv("ZOO_DATA_DIR", str(tmp_path / "data"))
    assert fetch_file("toy/a.dat") == path
    path.write_bytes(b"other")
    text = fails("toy/a.dat", "so this is another or a damaged file; replace it, or unset ZOO_DATA_DIR")
    assert text.startswith(f"{path}: sha256 = {hashlib.sha256(b'other').hexdigest()}: expected {DIGEST}")
    assert server.asked == []
    fetch_file("toy/b.dat")
    assert server.asked == ["/b.dat"], "what the folder does not hold is downloaded"


def test_a_wrong_download_is_not_kept(server: Server, tmp_path: Path) -> None:
    server.files["a.dat"] = b"other"
    fails(
        "toy/a.dat", r"toy/a\.dat: cannot be downloaded from .*a\.dat \(what came has another sha256\); set"
    )
    assert not [p for p in (tmp_path / "cache").rglob("*") if p.is_file()]


def test_a_missing_source(server: Server) -> None:
    del server.files["a.dat"]
    fails("toy/a.dat", r"cannot be downloaded from http://.*a\.dat \(HTTPError\); set ZOO_DATA_DIR")


def test_offline(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server.http.server_close()
    message = (
        r"^toy/a\.dat: cannot be downloaded from http://127\.0\.0\.1:\d+/a\.dat \(ConnectionError\); set "
        r"ZOO_DATA_DIR to a folder that holds toy/a\.dat \(it is not set\), or try again when online$"
    )
    fails("toy/a.dat", message)
    monkeypatch.setenv("ZOO_DATA_DIR", str(tmp_path))
    fails("toy/a.dat", r"\(.* does not hold it\)")


def test_a_cache_that_cannot_be_written(server: Server, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where the folder should be")
    fails("toy/a.dat", r"cannot be downloaded .* \(.*Error\); set ZOO_DATA_DIR")


def test_unknown_names() -> None:
    fails(
        "mouse-c6/p.dat", r"mouse-c6/p\.dat: unknown; did you mean 'mouse-c6/pC6_512\.dat'\? there is mouse"
    )
    with pytest.raises(FetchError, match="data set 'mouse_c6': unknown; did you mean 'mouse-c6'") as error:
        fetch_dataset("mouse_c6")
    assert str(error.value).endswith("there is mouse-c6, mouse-h1, cascaded-tanks")


@pytest.mark.needs_data
@pytest.mark.parametrize("dataset", ["mouse-c6", "cascaded-tanks"])
def test_the_measured_data(dataset: str, data_dir: Path) -> None:
    names = [name for name in FILES if name.startswith(f"{dataset}/")]
    assert fetch_dataset(dataset) == tuple(data_dir / name for name in names)
    for name in names:
        assert hashlib.sha256((data_dir / name).read_bytes()).hexdigest() == FILES[name][1]
