#!/usr/bin/env python3
"""A clip's bake in shards, as queues run them: shards_test.py PENUMBRA [CLASS...]"""

import os
import shutil
import signal
import subprocess
import sys
import time

from cli_case import PATIENCE, CliTest, main, program


class Shards(CliTest):
    ROUNDS = (0, 1, 2, 3)

    @classmethod
    def make_files(cls):
        for name in [name for name in cls.environment if name.startswith(("SLURM_", "JOB_COMPLETION"))]:
            del cls.environment[name]
        cls.whole = cls.baked_whole()

    @classmethod
    def baked_whole(cls, **options):
        done = cls.run_program(*cls.clip("whole.shlm", **options))
        assert done.returncode == 0, done.stderr
        return (cls.root / "whole.shlm").read_bytes()

    @classmethod
    def clip(cls, name, *more, bounces=1, samples=64, between=0):
        return ("bake", "builtin:walker", "--animation", "Walk", "-o", cls.root / name, "--fps", 6, "--bands", 2,
                "--bounces", bounces, "--samples", samples, "--ground-texels", 16, "--interpolation-error", between,
                *more)

    def bake_as(self, variables, *arguments):
        return subprocess.run([program(), *map(str, arguments)], env=self.environment | variables, cwd=self.root,
                              capture_output=True, text=True, timeout=300 * PATIENCE, check=False)

    def left_of(self, name):
        return sorted(path.name for path in self.root.glob(f"{name}.*"))

    def test_rounds_in_shards_are_the_same_file_and_leave_the_merge_nothing_to_bake(self):
        between, name = .05, "rounds.shlm"
        whole = self.baked_whole(between=between)
        for number in self.ROUNDS:
            for shard in (3, 1, 2):
                more = ("--round", number) if number else ()
                told = self.run_json(*self.clip(name, "--shard", f"{shard}/3", *more, between=between))
                end = f".round-{number}" if number else ""
                self.assertEqual(told["shard"], str(self.root / f"{name}.shard-{shard}-of-3{end}"))
        copies = self.root / "copies"
        copies.mkdir()
        for path in self.root.glob(f"{name}.*"):
            shutil.copy(path, copies)
        self.assertFalse(self.run_json(*self.clip(name, "--merge", 3, between=between))["merge_baked"])
        self.assertEqual((self.root / name).read_bytes(), whole)
        self.assertEqual(self.left_of(name), [])
        # Without the rounds it bakes what they hold.
        for path in copies.iterdir():
            if "round" not in path.name.partition("shlm")[2]:
                shutil.copy(path, self.root)
        self.assertTrue(self.run_json(*self.clip(name, "--merge", 3, between=between))["merge_baked"])
        self.assertEqual((self.root / name).read_bytes(), whole)

    def test_a_queue_tells_which_shard_a_task_is(self):
        for task in (7, 5, 6):  # an array that begins at 5
            done = self.bake_as({"SLURM_ARRAY_TASK_ID": str(task), "SLURM_ARRAY_TASK_MIN": "5",
                                 "SLURM_ARRAY_TASK_MAX": "7", "SLURM_ARRAY_TASK_COUNT": "3",
                                 "SLURM_CPUS_PER_TASK": "1"}, *self.clip("queue.shlm", "--shard", "auto"))
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(done.stdout.strip(), str(self.root / f"queue.shlm.shard-{task - 4}-of-3"))
        self.run_json(*self.clip("queue.shlm", "--merge", 3))
        self.assertEqual((self.root / "queue.shlm").read_bytes(), self.whole)
        for index in ("1", "0"):
            done = self.bake_as({"JOB_COMPLETION_INDEX": index}, *self.clip("pods.shlm", "--shard", "auto/2"))
            self.assertEqual(done.returncode, 0, done.stderr)
        self.run_json(*self.clip("pods.shlm", "--merge", 2))
        self.assertEqual((self.root / "pods.shlm").read_bytes(), self.whole)

    def test_make_runs_the_same_shards(self):
        if not shutil.which("make"):
            self.skipTest("make is not installed")
        words = " ".join(map(str, self.clip("make.shlm")))
        (self.root / "Makefile").write_text(
            f"make.shlm: make.shlm.shard-1-of-2 make.shlm.shard-2-of-2\n\t{program()} {words} --merge 2\n"
            f"make.shlm.shard-%-of-2:\n\t{program()} {words} --shard $*/2\n")
        done = subprocess.run(["make", "-j2"], env=self.environment, cwd=self.root, capture_output=True, text=True,
                              timeout=300 * PATIENCE, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual((self.root / "make.shlm").read_bytes(), self.whole)

    def test_parallel_runs_the_same_shards(self):
        if not shutil.which("parallel"):
            self.skipTest("GNU parallel is not installed")
        words = self.clip("parallel.shlm")
        done = subprocess.run(["parallel", "--jobs", "2", program(), *map(str, words), "--shard", "{}/3"],
                              env=self.environment | {"HOME": str(self.root)}, cwd=self.root, input="1\n2\n3\n",
                              capture_output=True, text=True, timeout=300 * PATIENCE, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.run_json(*self.clip("parallel.shlm", "--merge", 3))
        self.assertEqual((self.root / "parallel.shlm").read_bytes(), self.whole)

    def test_what_a_queue_does_not_tell_is_refused(self):
        array = {"SLURM_ARRAY_TASK_ID": "2", "SLURM_ARRAY_TASK_MIN": "1", "SLURM_ARRAY_TASK_MAX": "3",
                 "SLURM_ARRAY_TASK_COUNT": "3"}
        for words, variables, shard in (
                (["--shard", "SLURM_ARRAY_TASK_ID"], {}, "auto"),
                (["auto/n"], {"JOB_COMPLETION_INDEX": "0"}, "auto"),
                (["JOB_COMPLETION_INDEX", "2"], {"JOB_COMPLETION_INDEX": "2"}, "auto/2"),
                (["SLURM_ARRAY_TASK_COUNT", "gaps"], array | {"SLURM_ARRAY_TASK_COUNT": "2"}, "auto"),
                (["--shard", "3 tasks"], array, "auto/4"),
                (["SLURM_ARRAY_TASK_ID", "two"], array | {"SLURM_ARRAY_TASK_ID": "two"}, "auto"),
                (["--shard", "auto/0"], array, "auto/0"), (["--shard", "1/2x"], {}, "1/2x")):
            done = self.bake_as(variables, *self.clip("refused.shlm", "--shard", shard))
            self.assertEqual(done.returncode, 2, done.stderr)
            for word in words:
                self.assertIn(word, done.stderr.splitlines()[-1])
            self.assertEqual(self.left_of("refused.shlm"), [])
        self.expect_refusal(["--round"], *self.clip("refused.shlm", "--round", 1))
        self.expect_refusal(["refused.shlm.shard-1-of-2", "missing"],
                            *self.clip("refused.shlm", "--shard", "1/2", "--round", 1))
        self.expect_refusal(["--slurm"], *self.clip("refused.shlm", "--slurm", "--merge", 2))
        self.expect_refusal(["--slurm"], *self.clip("refused.shlm", "--print"))
        self.expect_refusal(["--copy", "builtin:walker"], *self.clip("refused.shlm", "--slurm", "--copy", "--print"))

    def test_a_merge_names_what_is_missing_foreign_or_cut_off(self):
        name = "faults.shlm"
        for shard in range(1, 5):
            self.run_json(*self.clip(name, "--shard", f"{shard}/4"))
        files = [self.root / f"{name}.shard-{shard}-of-4" for shard in range(1, 5)]
        good = [path.read_bytes() for path in files]
        files[1].unlink()
        files[3].unlink()
        self.expect_refusal([files[1].name, "missing", ": 4)"], *self.clip(name, "--merge", 4))
        files[3].write_bytes(good[3])
        self.run_json(*self.clip("other.shlm", "--shard", "2/4", bounces=2))  # stale: of other settings
        (self.root / "other.shlm.shard-2-of-4").rename(files[1])
        self.expect_refusal([files[1].name, "another bake"], *self.clip(name, "--merge", 4))
        self.expect_refusal([files[1].name, "another bake"], *self.clip(name, "--shard", "2/4"))
        files[1].write_bytes(good[2])  # foreign: another one's frames
        self.expect_refusal([files[1].name, "lacks 2 of the 2"], *self.clip(name, "--merge", 4))
        files[1].write_bytes(good[1][:-100])
        self.expect_refusal([files[1].name, "lacks 1 of the 2"], *self.clip(name, "--merge", 4))
        files[1].write_bytes(b"not a shard")
        self.expect_refusal([files[1].name, "not a journal"], *self.clip(name, "--merge", 4))
        self.assertFalse((self.root / name).exists())
        files[1].write_bytes(good[1])
        self.run_json(*self.clip(name, "--merge", 4))
        self.assertEqual((self.root / name).read_bytes(), self.whole)

    def test_a_shard_may_be_begun_again_and_twice_at_once(self):
        self.run_json(*self.clip("size.shlm", "--shard", "1/7"))  # one frame
        head = 32
        record = (self.root / "size.shlm.shard-1-of-7").stat().st_size - head
        shard = self.clip("again.shlm", "--shard", "1/2", samples=1024)
        file = self.root / "again.shlm.shard-1-of-2"

        def begin():
            return subprocess.Popen([program(), *map(str, shard)], env=self.environment, cwd=self.root,
                                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        def attempts():
            return [path for path in self.root.glob(f"{file.name}.attempt-*") if path.stat().st_size >= head + record]
        killed = begin()
        while not attempts() and killed.poll() is None:
            time.sleep(.01)
        killed.send_signal(signal.SIGKILL)
        killed.wait()
        self.assertFalse(file.exists())
        left = attempts()[0]
        kept = left.read_bytes()
        both = [begin(), begin()]
        self.assertEqual([one.wait(300 * PATIENCE) for one in both], [0, 0])
        self.assertEqual(self.left_of("again.shlm"), [file.name])
        first = file.read_bytes()
        # What the killed one had done was not baked again: each record tells how long that took.
        kept = kept[:head + (len(kept) - head) // record * record]
        self.assertEqual(first[:len(kept)], kept)
        before = file.stat()
        begin_s = time.monotonic()
        self.run_json(*shard)
        self.assertLess(time.monotonic() - begin_s, 5 * PATIENCE)
        self.assertEqual(file.stat().st_mtime_ns, before.st_mtime_ns)  # and is not written again

    def test_the_script_is_bash_that_submits_each_job_after_the_one_before(self):
        folder = self.root / "it's a $folder"
        folder.mkdir(exist_ok=True)
        script = self.run_well(*self.clip(folder / "clip.shlm", "--slurm", "--shards", 5, "--cores", 2, "--print",
                                           between=.05))
        fake = self.root / "fake"
        fake.mkdir(exist_ok=True)
        (fake / "sbatch").write_text("#!/usr/bin/env bash\ncat >>\"$0.scripts\"; printf '%s\\n' \"$@\" >>\"$0.words\"\n"
                                     "n=$(($(cat \"$0.count\" 2>/dev/null || echo 40) + 1)); echo $n >\"$0.count\"\n"
                                     "echo \"$n;cluster\"\n")
        (fake / "sbatch").chmod(0o755)
        done = subprocess.run(["bash", "-s"], input=script, env=dict(self.environment, PATH=f"{fake}:/usr/bin:/bin"),
                              capture_output=True, text=True, timeout=60, check=False)
        self.assertEqual((done.returncode, done.stdout), (0, "41 42 43 44 45\n"), done.stderr)
        words = (fake / "sbatch.words").read_text().splitlines()
        self.assertEqual([word for word in words if word.startswith("--dependency")],
                         [f"--dependency=afterany:{job}" for job in (41, 42, 43, 44)])
        self.assertEqual(words.count("--array=1-5"), 4)
        self.assertEqual(words.count("--cpus-per-task=2"), 5)
        self.assertEqual(words.count("--requeue"), 5)
        self.assertIn(f"--output={folder}/clip.shlm.slurm/shards-%a.log", words)
        # A job's text runs as it stands: here as the pod of another queue.
        job = (fake / "sbatch.scripts").read_text().split("#!/usr/bin/env bash\n")[1]
        done = subprocess.run(["bash", "-s"], input=job, env=self.environment | {"JOB_COMPLETION_INDEX": "4"},
                              capture_output=True, text=True, timeout=300 * PATIENCE, check=False, cwd=self.root)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertTrue((folder / "clip.shlm.shard-5-of-5").exists())

    def test_without_slurm_the_refusal_says_so(self):
        empty = self.root / "empty"
        empty.mkdir(exist_ok=True)
        done = self.bake_as({"PATH": str(empty)}, *self.clip("none.shlm", "--slurm"))
        self.assertEqual(done.returncode, 2)
        self.assertIn("penumbra: sbatch: is not installed", done.stderr)
        self.assertEqual(self.left_of("none.shlm"), [])


class ChartShards(CliTest):
    """Charts in shards: of a clip's frames, and of lights, where each asset in an environment is a case."""

    def lights(self, out, *more, bands=5):
        return ("chart", "--asset", "builtin:box", "--bands", bands, "--max-lights", 2, "--error", 0.03,
                "--out", self.root / out, *more)

    def rows_of(self, out, *more):
        return [{name: value for name, value in row.items() if "_ms" not in name}
                for row in self.run_json(*self.lights(out, *more))["rows"]]

    def test_coders_of_a_clip_in_shards_are_the_same_table(self):
        words = ("chart", "--animation", "Walk", "--frames", 5, "--samples", 64, "--light-map", "32x32", "--out")
        self.run_json(*words, self.root / "whole")
        for shard in (2, 1):
            told = self.run_json(*words, self.root / "parts", "--shard", f"{shard}/2")
            self.assertEqual(told["shard"], str(self.root / f"parts/clip.shard-{shard}-of-2"))
        (self.root / "parts/clip.shard-1-of-2").rename(self.root / "kept")
        self.expect_refusal(["clip.shard-1-of-2", "missing"], *words, self.root / "parts", "--merge", 2)
        (self.root / "kept").rename(self.root / "parts/clip.shard-1-of-2")
        self.run_json(*words, self.root / "parts", "--merge", 2)
        name = "rate-distortion.csv"
        self.assertEqual((self.root / "parts" / name).read_bytes(), (self.root / "whole" / name).read_bytes())
        self.assertEqual(list((self.root / "parts").glob("clip.shard*")), [])

    def test_cases_in_shards_are_the_rows_of_one_chart(self):
        whole = self.rows_of("whole-lights")
        self.assertEqual(len(whole), 2)
        for shard in (1, 2):
            self.run_json(*self.lights("lights", "--shard", f"{shard}/2"))
        files = [self.root / f"lights/chart.shard-{shard}-of-2" for shard in (1, 2)]
        good = files[1].read_bytes()
        files[1].unlink()
        self.expect_refusal([files[1].name, "missing"], *self.lights("lights", "--merge", 2))
        files[1].write_bytes(files[0].read_bytes())  # foreign
        self.expect_refusal([files[1].name, "another chart"], *self.lights("lights", "--merge", 2))
        files[1].write_bytes(good[:-9])
        self.expect_refusal([files[1].name, "not a whole shard"], *self.lights("lights", "--merge", 2))
        files[1].write_bytes(good)  # stale: of other settings
        self.expect_refusal([files[0].name, "another chart"], *self.lights("lights", "--merge", 2, bands=4))
        self.assertEqual(self.rows_of("lights", "--merge", 2), whole)
        self.assertEqual(list((self.root / "lights").glob("chart.shard*")), [])
        self.assertTrue((self.root / "lights/accuracy.csv").exists())


if __name__ == "__main__":
    sys.exit(main(__name__))
