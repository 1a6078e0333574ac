"""What the tests of the program share: a folder of their own, running it, and what a refusal is."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

PROGRAM = ""
# Sanitizers make the program many times slower; their presets say so.
PATIENCE = float(os.environ.get("PENUMBRA_TEST_PATIENCE", "1"))


def program():
    return PROGRAM


def command_of(arguments):
    """As `penumbra` would replace itself: to load two programs of two hundred libraries takes as long as
    most commands."""
    first, *rest = map(str, arguments) if arguments else [""]
    beside = {"demo": "penumbra-demo", "calibrate": "penumbra-calibrate", "chart": "penumbra-chart",
              "compare": "penumbra-chart"}.get(first)
    if not beside:
        return [PROGRAM, *map(str, arguments)]
    return [str(Path(PROGRAM).with_name(beside)), *([first] if beside == "penumbra-chart" else []), *rest]


class CliTest(unittest.TestCase):
    """A folder of its own for every class. What one bakes is there for the others of a run of ctest,
    but for a class that looks at its cache."""

    own_cache = False

    @classmethod
    def setUpClass(cls):
        cls.root = Path(tempfile.mkdtemp(prefix="penumbra-cli-"))
        shared = None if cls.own_cache else os.environ.get("PENUMBRA_TEST_BAKES")
        cls.environment = dict(os.environ, XDG_CACHE_HOME=shared or str(cls.root / "cache"))
        for name in ("DISPLAY", "WAYLAND_DISPLAY"):
            cls.environment.pop(name, None)
        cls.make_files()

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.root, ignore_errors=True)

    @classmethod
    def make_files(cls):
        pass

    @classmethod
    def run_program(cls, *arguments):
        return subprocess.run(command_of(arguments), env=cls.environment, capture_output=True, text=True,
                              errors="replace", timeout=300 * PATIENCE, cwd=cls.root, check=False)

    def shared_folder(self, relative):
        """Real pictures that are not part of the repository."""
        shared = os.environ.get("PENUMBRA_SHARED_DATA") or Path(__file__).parents[3] / "shared" / "data"
        folder = Path(shared) / relative
        if not folder.is_dir():
            self.skipTest(f"shared data folder absent: {folder}")
        return folder

    def run_well(self, *arguments):
        done = self.run_program(*arguments)
        if done.returncode == 2 and re.search(r"EGL|OpenGL ES", done.stderr):
            self.skipTest("no OpenGL ES 3.1: " + done.stderr.strip())
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("penumbra:", done.stderr)
        return done.stdout

    def run_json(self, *arguments):
        out = self.run_well(*arguments, "--json")
        value = json.loads(out)  # one object and nothing else
        self.assertIsInstance(value, dict)
        return value

    def expect_refusal(self, words, *arguments):
        """Exit status 2, one line that names the thing, nothing left in the folder out/."""
        out = self.root / "out"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        done = self.run_program(*arguments)
        what = f"{' '.join(map(str, arguments))}\n{done.stderr}"
        self.assertEqual(done.returncode, 2, what)
        lines = done.stderr.splitlines()
        self.assertTrue(lines, what)
        self.assertRegex(lines[-1], r"^penumbra: [^:].*: .", what)
        for line in lines[:-1]:
            # Or progress, which long work tells every ten seconds.
            self.assertRegex(line, r"^(info|warning): |^[^:]+: \d+ %", what)
        for word in ["terminate called", "what()", "Assertion", "Sanitizer"]:
            self.assertNotIn(word, done.stderr)
        for word in words:
            self.assertIn(word, lines[-1], what)
        self.assertEqual(done.stdout, "", what)
        self.assertEqual([str(p) for p in out.rglob("*") if p.is_file()], [], "left behind by " + what)

    def assert_close(self, found, expected, tolerance):
        self.assertLessEqual(abs(found - expected), tolerance, f"{found} is not {expected}")  # NaN fails


def main(module):
    global PROGRAM
    PROGRAM = str(Path(sys.argv[1]).resolve())
    program = unittest.main(module=module, argv=[sys.argv[0], *sys.argv[2:]], exit=False)
    result = program.result
    for _, reason in result.skipped:
        print(f"skipped: {reason}")
    if result.wasSuccessful() and result.skipped:  # one of several is named, too
        return 77
    return 0 if result.wasSuccessful() else 1
