"""A daemon that tests ask over HTTP: its start, its end, and requests. Standard library only."""

import http.client
import json
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
import unittest
from dataclasses import dataclass

import cli_files as files
from cli_case import PATIENCE, CliTest, program

RIG = """version = 1
[capture]
source = "studio"
environment = "even.hdr"
width = 128
height = 96
[scene]
file = "scene.toml"
[light]
bands = 2
stale_after_s = 30
[http]
port = 0
"""
SCENE = """version = 1
[[object]]
name = "box"
asset = "builtin:box"
fit_size_m = 0.4
[[real]]
plane = { point = [0, 0, 0], normal = [0, 1, 0] }
albedo = [0.4, 0.4, 0.4]
"""
TOKEN = "not-a-secret-0123456789"
JSON = {"Content-Type": "application/json"}
STREAMS = ("text/event-stream", "multipart/x-mixed-replace")


@dataclass
class Answer:
    status: int
    kind: str  # media type without parameters
    headers: dict
    body: bytes

    def json(self):
        return json.loads(self.body)


class UnixConnection(http.client.HTTPConnection):
    def __init__(self, path):
        super().__init__("localhost", timeout=20 * PATIENCE)
        self.path = path

    def connect(self):
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self.path))


class Daemon(CliTest):
    """One daemon for all tests of a class. Its own folder is that of running programs, too."""

    rig = RIG

    @classmethod
    def make_files(cls):
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))
        (cls.root / "scene.toml").write_text(SCENE)
        (cls.root / "token").write_text(TOKEN + "\n")
        (cls.root / "rig.toml").write_text(cls.rig)

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.addClassCleanup(shutil.rmtree, cls.root, ignore_errors=True)
        cls.lines = []
        cls.start()

    @classmethod
    def start(cls):
        environment = dict(cls.environment, XDG_RUNTIME_DIR=str(cls.root / "run"))
        environment.pop("RUNTIME_DIRECTORY", None)
        cls.process = subprocess.Popen([program(), "--config", str(cls.root / "rig.toml")], env=environment,
                                       cwd=cls.root, stderr=subprocess.PIPE, text=True)
        cls.addClassCleanup(cls.finish)
        listening = threading.Event()

        def read():
            for line in cls.process.stderr:
                cls.lines.append(line)
                if "listening on the socket" in line:
                    listening.set()
            listening.set()

        cls.reader = threading.Thread(target=read)
        cls.reader.start()
        listening.wait(120 * PATIENCE)
        said = "".join(cls.lines)
        port = re.search(r"listening on http://127\.0\.0\.1:(\d+)", said)
        if not port and re.search(r"EGL|OpenGL ES", said):
            raise unittest.SkipTest("no OpenGL ES 3.1: " + said.strip())
        if not port:
            raise AssertionError(said)
        cls.port = int(port[1])

    @classmethod
    def finish(cls):
        cls.process.send_signal(signal.SIGTERM)
        try:
            cls.process.wait(60 * PATIENCE)
        except subprocess.TimeoutExpired:
            cls.process.kill()
            cls.process.wait()
        cls.reader.join()
        cls.process.stderr.close()

    @classmethod
    def connection(cls):
        return http.client.HTTPConnection("127.0.0.1", cls.port, timeout=20 * PATIENCE)

    @classmethod
    def ask(cls, method, address, body=None, headers=None, connection=None):
        """body: bytes, or what becomes JSON; a stream is not read."""
        connection = connection or cls.connection()
        if body is not None and not isinstance(body, bytes):
            body, headers = json.dumps(body).encode(), {**JSON, **(headers or {})}
        try:
            connection.request(method, address, body, headers or {})
            reply = connection.getresponse()
            kind = reply.headers.get_content_type() if "Content-Type" in reply.headers else ""
            return Answer(reply.status, kind, dict(reply.headers), b"" if kind in STREAMS else reply.read())
        finally:
            connection.close()

    @classmethod
    def wait_for(cls, what, is_there):
        for _ in range(int(1500 * PATIENCE)):  # five minutes: bakes are slow beside other tests
            if is_there():
                return
            time.sleep(.2)
        raise AssertionError(f"{what} never came\n{''.join(cls.lines)}")

    @classmethod
    def wait_for_objects(cls):
        cls.wait_for("light", lambda: cls.ask("GET", "/v1/light").status == 200)
        cls.wait_for("the box", lambda: cls.ask("GET", "/v1/objects").json().get("objects"))
