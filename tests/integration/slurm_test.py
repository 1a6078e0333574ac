#!/usr/bin/env python3
"""Bakes a clip on a Slurm cluster of this machine: slurm_test.py PENUMBRA [CLASS...]

munge, a controller and three nodes run for this test alone, from Debian's packages.
"""

import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

from cli_case import PATIENCE, main, program
from slurm_cluster import Cluster, is_installed

SHARDS = 12


class Slurm(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        if not is_installed():
            raise unittest.SkipTest("Slurm is not installed")
        # Sockets have short names.
        cls.root = Path(tempfile.mkdtemp(prefix="penumbra-slurm-", dir="/tmp"))
        cls.addClassCleanup(shutil.rmtree, cls.root, ignore_errors=True)
        cls.cluster = Cluster(cls.root, 3)
        cls.addClassCleanup(cls.cluster.stop)
        cls.cluster.start()

    def clip(self, name, *more, asset="builtin:walker", clip="Walk", samples=64, between=0.03):
        return [program(), "bake", asset, "--animation", clip, "-o", name, "--fps", "12", "--bands", "2",
                "--bounces", "1", "--samples", str(samples), "--ground-texels", "16", "--interpolation-error",
                str(between), *map(str, more)]

    def run_clip(self, name, *more, **options):
        return subprocess.run(self.clip(name, *more, **options), cwd=self.root, env=self.cluster.environment,
                              capture_output=True, text=True, timeout=400 * PATIENCE, check=False)

    def begin(self, name, shards, *more, **options):
        words = self.clip(name, "--slurm", "--shards", shards, "--cores", 1, "--json", *more, **options)
        started = subprocess.Popen(words, cwd=self.root, env=self.cluster.environment, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)
        self.addCleanup(lambda: started.poll() is None and started.kill())
        return started

    def end(self, started):
        out, told = started.communicate(timeout=500 * PATIENCE)
        self.assertEqual(started.returncode, 0, told + self.cluster.logs())
        return json.loads(out), told

    def expect_the_same(self, name, **options):
        whole = self.root / f"whole-{'-'.join(map(str, options.values()))}.shlm"
        if not whole.exists():
            done = self.run_clip(whole.name, **options)
            self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual((self.root / name).read_bytes(), whole.read_bytes())
        self.assertEqual([path.name for path in self.root.glob(f"{name}.*")], [])  # shards, logs

    def wait_for_tasks(self, is_enough, what):
        self.cluster.wait_for(lambda: is_enough(self.cluster.running_tasks()), what)

    def task_on(self, node):
        return next((task for task, where in self.cluster.running_tasks() if where == node), None)

    def test_a_machine_and_a_job_that_are_lost_leave_the_same_file(self):
        name = "lost.shlm"
        started = self.begin(name, SHARDS, samples=512)
        self.cluster.wait_for(lambda: list(self.root.glob(f"{name}.shard-*-of-12")), "the first shard")
        self.wait_for_tasks(lambda tasks: {"n1", "n2"} <= {node for _, node in tasks}, "tasks on two nodes")
        bakes = program().encode() + b"\0bake"
        lost = self.cluster.wait_for(lambda: self.cluster.lose_power_at_work("n2", bakes), "a task on the second node")
        self.cluster.wait_for(lambda: self.cluster.kill_task(self.task_on("n1")), "a task on the first node")
        self.cluster.wait_for(lambda: "down" in "".join(self.cluster.states()), "a node that is down")
        self.cluster.start_node("n2")
        told, said = self.end(started)
        self.assertEqual(told["submissions"], 2, said)  # the killed job's shard was missing
        self.assertRegex(said, rf"warning: {name}: jobs ended without \S+shard-\d+-of-12\S*: submitted again")
        self.assertEqual((told["shards"], len(told["jobs"])), (SHARDS, 5))
        log = (self.root / "slurmctld.log").read_text(errors="replace")
        self.assertRegex(log, rf"(?i)requeu\w+ .*{lost.split('_')[0]}")
        self.expect_the_same(name, samples=512)

    def test_a_machine_that_is_cut_off_and_goes_on_does_no_harm(self):
        name = "cut.shlm"
        started = self.begin(name, SHARDS, samples=512)
        self.wait_for_tasks(lambda tasks: "n3" in {node for _, node in tasks}, "a task on the third node")
        self.cluster.cut_off("n3")
        self.cluster.wait_for(lambda: "down" in "".join(self.cluster.states()), "a node that is down")
        self.cluster.start_node("n3")
        told, _ = self.end(started)
        self.assertEqual(told["submissions"], 1)  # Slurm itself requeues its tasks
        self.expect_the_same(name, samples=512)

    def test_a_program_that_a_signal_ends_goes_on(self):
        name, killed = "signal.shlm", set()
        started = self.begin(name, 3, samples=1024, between=0)

        def kill_one(_):
            for node in self.cluster.nodes:
                for process in self.cluster.processes_of(node):
                    if not killed and self.cluster.name_of(process).startswith(program().encode() + b"\0bake"):
                        killed.add(process)
                        os.kill(process, signal.SIGKILL)
            return killed
        self.wait_for_tasks(kill_one, "the program of a task")
        told, _ = self.end(started)
        self.assertEqual(told["submissions"], 1)
        self.expect_the_same(name, samples=1024, between=0)

    def test_what_somebody_cancels_is_not_submitted_again(self):
        name = "cancelled.shlm"
        started = self.begin(name, SHARDS, samples=1024)
        self.wait_for_tasks(lambda tasks: tasks, "a task")
        self.cluster.cancel_all()
        out, told = started.communicate(timeout=300 * PATIENCE)
        self.assertEqual((started.returncode, out), (2, ""), told)
        self.assertRegex(told.splitlines()[-1], rf"^penumbra: {name}: job \d+ was cancelled")
        self.assertEqual(told.count("submitted as jobs"), 1)

    def test_a_chart_runs_there_too(self):
        words = [program(), "chart", "--asset", "builtin:box", "--bands", "5", "--max-lights", "2", "--error", "0.03",
                 "--out", "lights", "--json"]
        begun = subprocess.Popen([*words, "--slurm", "--cores", "1"], cwd=self.root, env=self.cluster.environment,
                                 stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(lambda: begun.poll() is None and begun.kill())
        told, _ = self.end(begun)
        self.assertEqual((told["shards"], len(told["jobs"]), told["submissions"]), (2, 2, 1))  # a case each
        table = (self.root / "lights/accuracy.csv").read_text().splitlines()
        self.assertEqual([row.split(",")[0] for row in table[1:]], ["room", "clear-sky"])
        self.assertEqual([path.name for path in (self.root / "lights").glob("chart.*")], [])

    def test_an_asset_is_copied_to_the_machines(self):
        (self.root / "box's.glb").write_bytes(turning_tetrahedron())
        of = {"asset": "box's.glb", "clip": "turn", "between": 0}
        script = self.run_clip("copy.shlm", "--slurm", "--shards", 2, "--copy", "--print", **of)
        self.assertEqual(script.stdout.count("sbcast --force"), 2, script.stderr)
        self.end(self.begin("copy.shlm", 2, "--copy", **of))
        self.expect_the_same("copy.shlm", **of)

    def test_what_the_program_refuses_is_told_and_not_tried_again(self):
        stale = self.root / "stale.shlm.shard-2-of-2.round-1"
        stale.write_text("not a shard, but long enough to be one of some kind")
        done = self.begin("stale.shlm", 2)
        out, told = done.communicate(timeout=300 * PATIENCE)
        self.assertEqual((done.returncode, out), (2, ""), told)
        self.assertIn(f".log: {stale.name}: is not a journal of a bake", told.splitlines()[-1])
        self.assertEqual(told.count("submitted as jobs"), 1)
        # What is known beforehand is refused before anything is submitted.
        (self.root / "stale.shlm.shard-1-of-2").write_bytes(stale.read_bytes())
        again = self.begin("stale.shlm", 2)
        told = again.communicate(timeout=300 * PATIENCE)[1]
        self.assertEqual(again.returncode, 2)
        self.assertNotIn("submitted", told)
        self.assertIn("stale.shlm.shard-1-of-2: is not a journal", told.splitlines()[-1])


def turning_tetrahedron():
    """A .glb file: a tetrahedron that goes round once in half a second."""
    places = struct.pack("<12f", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1)
    corners = struct.pack("<12H", 0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)
    times = struct.pack("<3f", 0, .25, .5)
    turns = struct.pack("<12f", 0, 0, 0, 1, 0, 1, 0, 0, 0, 0, 0, -1)
    parts, views, at = [places, corners, times, turns], [], 0
    for part in parts:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(part)})
        at += len(part)
    kinds = ((5126, 4, "VEC3"), (5123, 12, "SCALAR"), (5126, 3, "SCALAR"), (5126, 3, "VEC4"))
    accessors = [{"bufferView": view, "componentType": number, "count": count, "type": kind}
                 for view, (number, count, kind) in enumerate(kinds)]
    accessors[0] |= {"min": [0, 0, 0], "max": [1, 1, 1]}
    accessors[2] |= {"min": [0], "max": [.5]}
    text = json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "body"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "animations": [{"name": "turn", "samplers": [{"input": 2, "output": 3}],
                        "channels": [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}]}],
        "buffers": [{"byteLength": at}], "bufferViews": views, "accessors": accessors}).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(parts)
    head = struct.pack("<4s5I", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4e4f534a, 0)[:20]
    return head + text + struct.pack("<2I", len(binary), 0x004e4942) + binary


if __name__ == "__main__":
    sys.exit(main(__name__))
