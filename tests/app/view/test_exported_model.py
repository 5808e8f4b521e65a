"""Files of an exported page as servers and caches send them: packed, unpacked by the browser, or packed again."""

from __future__ import annotations

import gzip
import http.server
import json
import shutil
import struct
import subprocess
import threading
import zlib
from pathlib import Path

import pytest

import palpate as pt

SOURCES = Path(pt.__file__).parents[2] / "page" / "src"
NODE = shutil.which("node")
OPENING = """import { openModel } from "./exportedModel.mjs";
for (const address of process.argv.slice(2)) {
  try {
    console.log("opened", [...(await openModel(address)).arrays.numbers].join(" "));
  } catch (error) { console.log(error.message); }
}"""
NUMBERS = bytes(range(3, 200, 7))
HTML = b"<!doctype html><title>A page of the server</title>"

pytestmark = pytest.mark.skipif(
    NODE is None or not SOURCES.is_dir(), reason="needs Node and the page's sources; on Debian: apt-get install nodejs"
)


def model_image():
    """Return the memory of a model (palpate.h) with one array of bytes."""
    header = bytes(12) + struct.pack("<I", 1) + bytes(48)
    entry = b"numbers".ljust(24, b"\0") + struct.pack("<QIIII", 112, 4, len(NUMBERS), 1, 0)
    return (header + entry + NUMBERS).ljust(500, b"\0")


def module(size):
    """Return a module of WebAssembly whose functions state the size of a model, and that it is right."""
    types = bytes([2, 0x60, 0, 1, 0x7E, 0x60, 1, 0x7F, 1, 0x7F])  # () -> i64, (i32) -> i32
    names = b"".join(
        bytes([len(name)]) + name + bytes([0, k]) for k, name in enumerate([b"model_file_size", b"model_check"])
    )
    leb = bytes([size & 0x7F | 0x80, size >> 7])
    first, second = b"\0\x42" + leb + b"\x0b", b"\0\x41\0\x0b"
    code = bytes([2, len(first)]) + first + bytes([len(second)]) + second
    sections = [(1, types), (3, bytes([2, 0, 1])), (7, bytes([2]) + names), (10, code)]
    return b"\0asm\1\0\0\0" + b"".join(bytes([kind, len(body)]) + body for kind, body in sections)


IMAGE = model_image()
FILES = {
    "model.json": json.dumps({"data_end": 0, "memory_size": len(IMAGE)}).encode(),
    "model.gz": gzip.compress(IMAGE),
    "simd.wasm": module(len(IMAGE)),
    "scalar.wasm": module(len(IMAGE)),
}


def plain(name, content):
    return content, {}


def declared(name, content):
    return content, {"Content-Encoding": "gzip"} if name.endswith(".gz") else {}


def all_packed(name, content):
    """As a server that packs every answer."""
    return gzip.compress(content), {"Content-Encoding": "gzip"}


def declared_and_deflated(name, content):
    return zlib.compress(content), {"Content-Encoding": "deflate"}


def packed_twice(name, content):
    return gzip.compress(gzip.compress(content)), {"Content-Encoding": "gzip"}


def packed_without_a_word(name, content):
    return gzip.compress(content), {}


def stored_unpacked(name, content):
    return gzip.decompress(content) if name == "model.gz" else content, {}


def of_another_type(name, content):
    return content, {"Content-Type": "text/html"}


SENDERS = [
    plain, declared, all_packed, declared_and_deflated, packed_twice, packed_without_a_word, stored_unpacked,
    of_another_type,
]  # fmt: skip


def page_of_its_own(name):
    return lambda given, content: (HTML, {"Content-Type": "text/html"}) if given == name else (content, {})


def changed(name, change):
    return lambda given, content: (change(content) if given == name else content, {})


REFUSED = {
    "another page in place of the model": (page_of_its_own("model.gz"), "model.gz is damaged, or of another page"),
    "another page in place of the functions": (page_of_its_own("simd.wasm"), "simd.wasm is another file"),
    "another page in place of the constants": (page_of_its_own("model.json"), "model.json is another file"),
    "cut off": (changed("model.gz", lambda content: content[: len(content) // 2]), "model.gz is damaged"),
    "changed": (changed("model.gz", lambda content: content[:20] + b"xyz" + content[23:]), "model.gz is damaged"),
    "empty": (changed("model.gz", lambda content: b""), "model.gz is damaged"),
}


def serve(send):
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            name = self.path.strip("/")
            content, headers = send(name, FILES[name])
            self.send_response(200)
            for each in (headers | {"Content-Length": str(len(content))}).items():
                self.send_header(*each)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *words):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """What came of opening the model from each server, by its name; in one process of Node, which takes a second."""
    folder = tmp_path_factory.mktemp("node")
    (folder / "exportedModel.mjs").write_text((SOURCES / "exportedModel.js").read_text())
    (folder / "open.mjs").write_text(OPENING)
    senders = {send.__name__: send for send in SENDERS} | {name: send for name, (send, _) in REFUSED.items()}
    servers = {name: serve(send) for name, send in senders.items()}
    addresses = [f"http://127.0.0.1:{each.server_port}/" for each in servers.values()]
    command = [str(NODE), "open.mjs", *addresses]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    for each in servers.values():
        each.shutdown()
        each.server_close()
    return dict(zip(servers, done.stdout.splitlines(), strict=True))


@pytest.mark.parametrize("name", [send.__name__ for send in SENDERS])
def test_a_model_opens_however_a_server_packs_its_files(opened, name):
    assert opened[name] == "opened " + " ".join(str(byte) for byte in NUMBERS)


@pytest.mark.parametrize("name", REFUSED)
def test_other_contents_are_named(opened, name):
    assert REFUSED[name][1] in opened[name]
