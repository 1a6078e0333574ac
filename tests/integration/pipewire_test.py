#!/usr/bin/env python3
"""Watches the service's PipeWire output with real consumers: pipewire_test.py SHOW_FRAMES [CLASS...]

A message bus, PipeWire and its session manager run for this test alone, without a display or sound.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

from cli_case import PATIENCE, main, program

NEEDED = ("dbus-daemon", "pipewire", "wireplumber", "pw-cli", "gst-launch-1.0", "gst-inspect-1.0")
WIDTH, HEIGHT, RATE_HZ = 640, 360, 30
FRAME_BYTES = WIDTH * HEIGHT * 4
# As in tests/support/moving_bars.h: red, green, blue.
BARS = [(235, 235, 235), (200, 190, 30), (30, 180, 190), (40, 170, 50),
        (180, 50, 170), (190, 40, 30), (30, 50, 190), (16, 16, 16)]
NODE = "penumbra-test"


def is_installed():
    if any(shutil.which(name) is None for name in NEEDED):
        return False
    asked = subprocess.run(["gst-inspect-1.0", "pipewiresrc"], capture_output=True, check=False)
    return asked.returncode == 0


class PipeWire(unittest.TestCase):
    def setUp(self):
        if not is_installed():
            self.skipTest("PipeWire is not installed")
        self.root = Path(tempfile.mkdtemp(prefix="penumbra-pipewire-"))
        self.addCleanup(shutil.rmtree, self.root, ignore_errors=True)
        self.running = []
        self.addCleanup(self.end_all)
        self.environment = dict(os.environ, XDG_RUNTIME_DIR=str(self.root / "run"), HOME=str(self.root),
                                XDG_CONFIG_HOME=str(self.root / "config"), XDG_STATE_HOME=str(self.root / "state"),
                                XDG_CACHE_HOME=str(self.root / "cache"))
        for name in ("DISPLAY", "WAYLAND_DISPLAY", "PIPEWIRE_REMOTE", "PIPEWIRE_RUNTIME_DIR"):
            self.environment.pop(name, None)
        (self.root / "run").mkdir(mode=0o700)
        self.configure_session_manager()
        bus = self.start("dbus-daemon", "--session", "--nofork", "--print-address=1", stdout=subprocess.PIPE)
        self.environment["DBUS_SESSION_BUS_ADDRESS"] = bus.stdout.readline().strip()

    def configure_session_manager(self):
        """No hardware: Bluetooth without logind would end it."""
        monitors = {"bluetooth": ["bluez_monitor.enabled = false",
                                  "bluez_monitor.properties = { [\"with-logind\"] = false }"],
                    "main": ["alsa_monitor.enabled = false", "v4l2_monitor.enabled = false",
                             "libcamera_monitor.enabled = false"]}
        for name, lines in monitors.items():
            folder = self.root / "config" / "wireplumber" / f"{name}.lua.d"
            folder.mkdir(parents=True)
            (folder / "80-no-hardware.lua").write_text("\n".join(lines) + "\n")

    def start(self, *command, **options):
        options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL} | options
        process = subprocess.Popen(list(map(str, command)), env=self.environment, cwd=self.root, text=True, **options)
        self.running.append(process)
        return process

    def end(self, process, how=signal.SIGTERM):
        if process.poll() is None:
            process.send_signal(how)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for stream in (process.stdout, process.stderr):
            if stream:
                stream.close()
        self.running.remove(process)

    def end_all(self):
        for process in reversed(list(self.running)):
            self.end(process)

    def start_server(self):
        socket = self.root / "run" / "pipewire-0"
        server = self.start("pipewire")
        self.wait_for(socket.exists, "PipeWire's socket")
        return server, self.start("wireplumber")

    def wait_for(self, is_there, what, limit_s=20):
        until = time.monotonic() + limit_s * PATIENCE
        while time.monotonic() < until:
            if is_there():
                return
            time.sleep(.05)
        self.fail(f"{what} did not come in {limit_s} s")

    def show(self, seconds, **options):
        return self.start(program(), "pipewire", NODE, seconds, WIDTH, HEIGHT, RATE_HZ, **options)

    def nodes(self):
        listed = subprocess.run(["pw-cli", "ls", "Node"], env=self.environment, capture_output=True, text=True,
                                timeout=20, check=False)
        return listed.stdout

    def wait_for_node(self):
        self.wait_for(lambda: f'node.name = "{NODE}"' in self.nodes(), "the node")

    def watch(self, name, frames):
        """A consumer that writes pixels to a file and tells of each buffer."""
        return self.start("gst-launch-1.0", "-v", "pipewiresrc", f"target-object={NODE}", f"num-buffers={frames}", "!",
                          "video/x-raw", "!", "identity", "silent=false", "!", "filesink",
                          f"location={self.root / name}", stdout=subprocess.PIPE, stderr=subprocess.STDOUT)

    def seen_by(self, watcher, name, frames):
        """(times of the buffers in seconds, pixels) of a consumer that has seen enough."""
        try:
            told, _ = watcher.communicate(timeout=40 * PATIENCE)
        except subprocess.TimeoutExpired:
            watcher.kill()
            told, _ = watcher.communicate()
            self.fail(f"{name} did not see {frames} frames:\n{told[-2000:]}")
        self.assertEqual(watcher.returncode, 0, told[-2000:])
        self.assertIn("format=(string)BGRx", told)
        self.assertIn(f"framerate=(fraction){RATE_HZ}/1", told)
        found = re.findall(r"chain .*?pts: (\d+):(\d+):([\d.]+)", told)
        times = [int(h) * 3600 + int(m) * 60 + float(s) for h, m, s in found]
        pixels = (self.root / name).read_bytes()
        self.assertEqual(len(times), frames, told[-2000:])
        self.assertEqual(len(pixels), frames * FRAME_BYTES)
        return times, pixels

    def check_pictures(self, times, pixels):
        """Exact colours of the bars, and a square that moves: by how many places from picture to picture."""
        places = []
        for at in range(0, len(pixels), FRAME_BYTES):
            for bar, (r, g, b) in enumerate(BARS):
                x, y = (2 * bar + 1) * WIDTH // 16, HEIGHT // 3
                pixel = at + (y * WIDTH + x) * 4
                self.assertEqual(tuple(pixels[pixel:pixel + 3]), (b, g, r), f"bar {bar}")
            row = pixels[at + (HEIGHT - 4) * WIDTH * 4:at + (HEIGHT - 3) * WIDTH * 4]
            white = (row.find(b"\xff\xff\xff") + 1) // 4  # beside it the fourth byte of black
            places.append(white // (WIDTH // 16))
        # After sixteen frames the square is where it was: which of these steps it took, their times tell.
        steps = [self.step_at((times[i + 1] - times[i]) * RATE_HZ, places[i + 1] - places[i])
                 for i in range(len(places) - 1)]
        # Each frame comes once and in its order; on a machine that is busy some are left out.
        self.assertTrue(all(step >= 1 for step in steps), (places, times))
        self.assertTrue(all(abs(step - (times[i + 1] - times[i]) * RATE_HZ) < 3 for i, step in enumerate(steps)),
                        (places, times))
        return steps

    @staticmethod
    def step_at(periods, places):
        """The number congruent to `places` modulo sixteen that is nearest to `periods`."""
        return places + 16 * round((periods - places) / 16)

    def check_times(self, times, steps):
        """They rise as the pictures do: a picture that stepped twice was taken two periods later."""
        apart = [b - a for a, b in zip(times, times[1:])]
        self.assertTrue(all(a > 0 for a in apart), times)
        expected = sum(steps) / RATE_HZ
        self.assertLess(abs(times[-1] - times[0] - expected), .15 * expected + 1 / RATE_HZ, times)

    def check_watcher(self, watcher, name, frames):
        times, pixels = self.seen_by(watcher, name, frames)
        self.check_times(times, self.check_pictures(times, pixels))

    def test_two_consumers_see_the_same_camera_and_come_again(self):
        self.start_server()
        shown = self.show(60, stderr=subprocess.PIPE)
        self.wait_for_node()
        frames = 45
        both = [self.watch(name, frames) for name in ("one", "two")]
        for name, watcher in zip(("one", "two"), both):
            self.check_watcher(watcher, name, frames)
        self.check_watcher(self.watch("again", 20), "again", 20)
        self.assertIsNone(shown.poll(), "the output goes on")

    def test_the_node_says_that_it_is_a_camera(self):
        self.start_server()
        self.show(60)
        self.wait_for_node()
        node = [part for part in self.nodes().split("id ") if f'node.name = "{NODE}"' in part]
        self.assertEqual(len(node), 1)
        self.assertIn('media.class = "Video/Source"', node[0])
        self.assertIn('node.description = "Frames of a test"', node[0])

    def test_frames_are_handed_on_only_while_somebody_watches(self):
        self.start_server()
        shown = self.show(9, stderr=subprocess.PIPE)
        self.wait_for_node()
        self.check_watcher(self.watch("some", 20), "some", 20)
        _, told = shown.communicate(timeout=30 * PATIENCE)
        counts = re.search(r"offered (\d+) shown (\d+)", told)
        self.assertTrue(counts, told)
        self.assertGreaterEqual(int(counts[2]), 20)
        self.assertLess(int(counts[2]), int(counts[1]) / 2)

    def test_it_comes_back_when_the_server_does(self):
        shown = self.show(120, stderr=subprocess.PIPE)
        unreachable = f"warning: PipeWire node {NODE}: cannot be reached: is PipeWire running?\n"
        self.assertEqual(shown.stderr.readline(), unreachable)
        server, manager = self.start_server()
        self.assertEqual(shown.stderr.readline(), f"info: PipeWire node {NODE}: goes on\n")
        self.wait_for_node()
        self.check_watcher(self.watch("before", 20), "before", 20)
        self.end(server, signal.SIGKILL)
        self.end(manager, signal.SIGKILL)
        self.assertEqual(shown.stderr.readline(), unreachable)
        (self.root / "run" / "pipewire-0").unlink(missing_ok=True)
        time.sleep(5)  # two tries fail meanwhile, and are not told
        self.start_server()
        self.assertEqual(shown.stderr.readline(), f"info: PipeWire node {NODE}: goes on\n")
        self.wait_for_node()
        self.check_watcher(self.watch("after", 20), "after", 20)


if __name__ == "__main__":
    sys.exit(main(__name__))
