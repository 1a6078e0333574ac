#!/usr/bin/env python3
"""Runs what the tutorial of the bake farm tells people to type: farm_tutorial_test.py ROOT

The list of baked assets, the script by which rooms fetch them, the Makefile of shards, and the loops;
in folders of this test, with a stand-in for the program.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

ROOT = Path(sys.argv.pop(1)) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/tutorials/bake-farm.md").read_text()

# Makes the file that `--shard I/N [--round R]` or `--merge N` would, and refuses to merge without shards.
PENUMBRA = """#!/usr/bin/env bash
set -euo pipefail
round=
while (($#)); do
  case $1 in
    -o) out=$2; shift ;;
    --shard) shard=$2; shift ;;
    --round) round=.round-$2; shift ;;
    --merge) merge=$2; shift ;;
  esac
  shift
done
if [[ -n ${shard:-} ]]; then echo "$shard" >"$out.shard-${shard%/*}-of-${shard#*/}$round"; exit; fi
for i in $(seq "$merge"); do cat "$out.shard-$i-of-$merge"; done >"$out"
"""


def block(language, start):
    found = [text for kind, text in re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
             if kind == language and text.startswith(start)]
    assert len(found) == 1, f"{len(found)} blocks of {language} start with {start}"
    return found[0]


class Tutorial(unittest.TestCase):
    def setUp(self):
        self.root = Path(tempfile.mkdtemp(prefix="penumbra-farm-"))
        self.addCleanup(shutil.rmtree, self.root)
        self.farm, self.room = self.root / "srv/assets", self.root / "lib/assets"
        self.farm.mkdir(parents=True)
        self.bin = self.root / "bin"
        self.bin.mkdir()
        self.program("systemctl", f'#!/bin/sh\necho "$@" >>{self.root}/restarts\n')
        self.program("penumbra", PENUMBRA)

    def program(self, name, text):
        (self.bin / name).write_text(text)
        (self.bin / name).chmod(0o755)

    def run_text(self, text, folder):
        text = text.replace("/srv/penumbra", str(self.root / "srv")).replace("/var/lib/penumbra",
                                                                            str(self.root / "lib"))
        environment = dict(os.environ, PATH=f"{self.bin}:{os.environ['PATH']}")
        return subprocess.run(["bash", "-c", text], cwd=folder, env=environment, capture_output=True, text=True,
                              timeout=120, check=False)

    def bake(self, name, text):
        (self.farm / name).write_text(text)

    def list_assets(self):
        done = self.run_text(block("sh", "cd /srv/penumbra/assets"), self.root)
        self.assertEqual(done.returncode, 0, done.stderr)

    def fetch(self):
        return self.run_text(block("sh", "set -e\nfrom="), self.root)

    def restarts(self):
        path = self.root / "restarts"
        return len(path.read_text().splitlines()) if path.exists() else 0

    def test_a_room_fetches_what_is_new_once(self):
        self.bake("walk.shlm", "walk")
        self.bake("a lamp.glb", "lamp")
        self.list_assets()
        for _ in range(2):
            done = self.fetch()
            self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual((self.room / "a lamp.glb").read_text(), "lamp")
        self.assertEqual((self.room / "walk.shlm").read_text(), "walk")
        self.assertEqual(self.restarts(), 1)

    def test_a_damaged_file_of_the_room_is_fetched_again(self):
        self.bake("walk.shlm", "walk")
        self.list_assets()
        self.fetch()
        (self.room / "walk.shlm").write_text("wa")
        done = self.fetch()
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual((self.room / "walk.shlm").read_text(), "walk")

    def test_a_file_that_was_cut_off_changes_nothing(self):
        self.bake("walk.shlm", "walk")
        self.bake("box.glb", "box")
        self.list_assets()
        self.fetch()
        self.bake("walk.shlm", "walk 2")
        self.bake("box.glb", "box 2")
        self.list_assets()
        self.bake("walk.shlm", "wa")
        self.assertNotEqual(self.fetch().returncode, 0)
        self.assertEqual((self.room / "walk.shlm").read_text(), "walk")
        self.assertEqual((self.room / "box.glb").read_text(), "box")
        self.assertEqual(self.restarts(), 1)

    def test_make_bakes_the_shards_and_takes_them_away(self):
        (self.root / "character.glb").write_text("")
        (self.root / "Makefile").write_text(block("make", "shards :="))
        done = self.run_text("make -j3", self.root)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual((self.root / "walk.shlm").read_text(), "".join(f"{i}/12\n" for i in range(1, 13)))
        self.assertEqual(list(self.root.glob("walk.shlm.*")), [])

    def test_the_loops_bake_all_rounds_before_the_merge(self):
        done = self.run_text("set -e\n" + block("sh", 'bake="penumbra'), self.root)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(len(list(self.root.glob("walk.shlm.shard-*.round-3"))), 12)
        self.assertEqual(len((self.root / "walk.shlm").read_text().splitlines()), 12)


if __name__ == "__main__":
    unittest.main()
