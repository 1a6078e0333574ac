#!/usr/bin/env python3
"""A webcam film of a printed board, played to `serve --quick`: quick_test.py PROGRAM FILM_BOARD"""

import json
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request

import cli_files as files
from cli_case import PATIENCE, CliTest, main, program

FILM_BOARD = ""


class Quick(CliTest):
    @classmethod
    def make_files(cls):
        subprocess.run([FILM_BOARD, str(cls.root / "film.mkv")], check=True)
        files.write_hdr(cls.root / "even.hdr", 64, 32, (8.0, 8.0, 8.0))

    def start(self, *more):
        process = subprocess.Popen([program(), "serve", "--quick", "--source", "film.mkv", "--port", "0",
                                    "--asset", "builtin:box", "--environment", "even.hdr", *more],
                                   env=self.environment, cwd=self.root, text=True, stderr=subprocess.PIPE)
        self.addCleanup(self.end, process)
        lines, listens = [], threading.Event()

        def read():
            for line in process.stderr:
                lines.append(line)
                if "listening on http" in line:
                    listens.set()
            listens.set()

        threading.Thread(target=read, daemon=True).start()
        listens.wait(60 * PATIENCE)
        said = "".join(lines)
        found = re.search(r"http://127\.0\.0\.1:(\d+)", said)
        if not found and re.search(r"EGL|OpenGL ES", said):
            self.skipTest("no OpenGL ES 3.1: " + said.strip())
        self.assertTrue(found, said)
        return int(found.group(1)), lines, process

    def end(self, process):
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
        process.stderr.close()

    def ask(self, port, path):
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=20 * PATIENCE) as reply:
            return reply.read()

    def wait_for(self, true, what, lines):
        end = time.monotonic() + 120 * PATIENCE
        while time.monotonic() < end:
            try:
                if true():
                    return
            except OSError:
                pass  # stale light is answered with 503
            time.sleep(.2)
        self.fail(what + "\n" + "".join(lines))

    def test_an_object_stands_on_the_board_in_the_light_of_the_map(self):
        port, lines, process = self.start()
        state = lambda: json.loads(self.ask(port, "/v1/state"))  # noqa: E731
        self.wait_for(lambda: (state()["pose"] or {}).get("opacity") == 1, "the board was never found", lines)
        # How sure the pose is, as the tracker says.
        sure = state()["pose"]
        self.assertTrue(0 < sure["sigma_mm"] < 20 and 0 < sure["sigma_deg"] < 2, sure)
        self.assertGreaterEqual(sure["extrapolated_ms"], 0)
        self.wait_for(lambda: state()["objects"], "no object", lines)
        self.wait_for(lambda: state()["light"], "no light", lines)
        now = state()
        self.assertEqual(now["objects"][0]["position_m"], [0, 0, 0])
        self.assertEqual(now["pose"]["trouble"], "")
        self.assertLess(now["pose"]["age_s"], .1)
        self.assertGreater(now["pose"]["accepted"], 0)
        self.assertEqual(now["pose"]["rejected"], 0)
        # The paper has the code 225, so it sends .75 of full scale: the map of 8 is dimmed to that.
        mean = now["light"]["mean_radiance"]
        for channel in mean:
            self.assert_close(channel, .75 / .8, .08)
        # An object's picture differs from one without it, around the middle of the board.
        (self.root / "with.png").write_bytes(self.ask(port, "/v1/frame.png"))
        width, height, pixels = files.read_png(self.root / "with.png")[:3]
        self.assertEqual((width, height), (640, 480))
        process.send_signal(signal.SIGTERM)
        self.assertEqual(process.wait(timeout=60 * PATIENCE), 0, "".join(lines))

    def test_flags_that_cannot_be_are_refused(self):
        self.expect_refusal(["--config", "--quick"], "serve")
        self.expect_refusal(["--board"], "serve", "--quick", "--source", "film.mkv", "--board", "charuco:8")
        self.expect_refusal(["nothing.mkv"], "serve", "--quick", "--source", "nothing.mkv")
        self.expect_refusal(["--size"], "serve", "--quick", "--source", "film.mkv", "--size", "-1")


if __name__ == "__main__":
    FILM_BOARD = sys.argv.pop(2)
    sys.exit(main(sys.modules[__name__]))
