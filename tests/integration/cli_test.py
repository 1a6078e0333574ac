#!/usr/bin/env python3
"""Runs the program as a user does: cli_test.py PROGRAM [CLASS...]"""

import base64
import csv
import json
import math
import os
import pathlib
import random
import re
import signal
import shutil
import struct
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request

import cli_files as files
from cli_case import PATIENCE, CliTest, main, program

SUMMARY_KEYS = {"frames", "dropped", "seconds", "fps", "stages", "processor", "configuration",
                "touched_fraction"}


class DemoAndComposite(CliTest):
    def check_summary(self, summary):
        self.assertLessEqual(SUMMARY_KEYS, set(summary))
        self.assertIsNone(summary["processor"])  # of a live run alone
        self.assertEqual(summary["frames"], 6)
        queues = ("view", "environment", "foreground", "for_light", "unmatched_eyes")
        self.assertEqual(summary["dropped"], dict.fromkeys(queues, 0))
        self.assertEqual(summary["configuration"]["coverage"], 1)
        self.assertTrue(0 < summary["touched_fraction"] < 1)
        self.assertTrue(summary["stages"])
        for stage in summary["stages"].values():
            self.assertLessEqual({"p50_ms", "p99_ms"}, set(stage))
            self.assertLessEqual(stage["p50_ms"], stage["p99_ms"])
        self.assertLessEqual({"bands", "lights", "exposures"}, set(summary["configuration"]))

    def test_recorded_demo_replays_to_the_same_pictures_and_bytes(self):
        demo, record = self.root / "demo", self.root / "record"
        printed = self.run_json("demo", "--headless", "--frames", 6, "--width", 160, "--height", 90, "--out", demo,
                                "--asset", "builtin:box", "--real-mesh", "builtin:box", "--record", record)
        self.check_summary(printed)
        self.check_summary(json.loads((demo / "summary.json").read_text()))
        runs = [self.root / "first", self.root / "second"]
        for run in runs:
            self.check_summary(self.run_json("composite", "--capture", record, "--scene", record / "scene.toml",
                                             "--coarse", "--out", run, *([] if run == runs[0] else ["--no-stills"])))
            self.check_summary(json.loads((run / "summary.json").read_text()))
        frames = [f"frame_{i:06}.png" for i in range(6)]
        self.assertEqual(sorted(p.name for p in runs[0].iterdir()), sorted(frames + ["summary.json", "video.mp4"]))
        self.assertEqual((demo / "video.mp4").read_bytes(), (runs[0] / "video.mp4").read_bytes())
        self.assertEqual(files.read_png(demo / "still.png"), files.read_png(runs[0] / frames[-1]))
        self.assertEqual(sorted(p.name for p in runs[1].iterdir()), ["summary.json", "video.mp4"])
        self.assertEqual((runs[0] / "video.mp4").read_bytes(), (runs[1] / "video.mp4").read_bytes())
        seen = self.run_json("hdr", "environment", record, "-o", self.root / "seen.exr")
        self.assertEqual((seen["coverage"], seen["width"]), (1, 2 * seen["height"]))
        light = self.run_json("light", "estimate", self.root / "seen.exr")["mean_radiance"]
        self.assertTrue(all(40 < c < 80 for c in light), f"the studio's mean luminance is 60: {light}")
        self.assertNotEqual(files.read_png(demo / "still.png"), files.read_png(demo / "camera.png"), "nothing drawn")

    def test_what_a_depth_camera_sees_in_front_hides_objects(self):
        files.write_scene(self.root)
        pictures = {}
        for name in ("plain", "with_depth"):
            capture, out = self.root / f"{name}_capture", self.root / name
            files.write_capture(capture)
            if name == "with_depth":
                files.add_depth(capture, lambda x, y: 500 if x >= 16 else 0)
                seen = self.run_json("inspect", capture)["cameras"]
                self.assertEqual([(c["name"], c["role"]) for c in seen][2], ("depth", "depth"))
            self.run_json("composite", "--capture", capture, "--scene", self.root / "scene.toml", "--coarse",
                          "--out", out)
            pictures[name] = files.read_png(out / "frame_000000.png")
        width, height, camera = files.read_png(self.root / "with_depth_capture" / "view" / "0.png")
        _, _, plain = pictures["plain"]
        _, _, ours = pictures["with_depth"]

        def part(picture, x0, x1):
            return b"".join(picture[3 * (y * width + x0):3 * (y * width + x1)] for y in range(height))
        self.assertNotEqual(part(plain, 40, 64), part(camera, 40, 64), "nothing is drawn there")
        self.assertEqual(part(ours, 40, 64), part(camera, 40, 64), "a board stands in front")
        self.assertEqual(part(ours, 0, 24), part(plain, 0, 24), "nothing stands in front")
        (self.root / "with_depth_capture" / "depth" / "0.png").write_bytes(
            (self.root / "with_depth_capture" / "view" / "0.png").read_bytes())
        self.expect_refusal(["depth/0.png", "64x48 pixels instead of 32x24"], "composite", "--capture",
                            self.root / "with_depth_capture", "--scene", self.root / "scene.toml", "--coarse",
                            "--out", self.root / "refused")

    def test_what_clips_in_every_exposure_is_said_by_every_step(self):
        capture = self.root / "clipped"
        files.write_capture(capture)
        for i, code in enumerate((60, 160)):
            files.write_png(capture / "environment" / f"{i}.png", 32, 16,
                            lambda x, y, c=code: (255, 255, 255) if 14 < x < 18 and 3 < y < 6 else (c, c, c))
        self.run_json("hdr", "environment", capture, "-o", self.root / "clipped.exr")
        light = self.run_json("light", "estimate", self.root / "clipped.exr")
        self.assertGreater(light["clipped_fraction"], 0)
        self.assertTrue(any(one["lower_bound"] for one in light["lights"]), light["lights"])
        said = self.run_program("light", "estimate", self.root / "clipped.exr")
        self.assertRegex(said.stderr, "warning: .*clipped.exr: .* is saturated in every exposure")
        self.assertIn("at least", said.stdout)

    def test_what_a_fisheye_does_not_see_is_said_by_every_step(self):
        capture = self.root / "fisheye"
        files.write_capture(capture)
        files.write_scene(self.root)
        for i, code in enumerate((60, 160)):
            files.write_png(capture / "environment" / f"{i}.png", 32, 32, lambda x, y, c=code: (c, c, c))
        text = (capture / "capture.toml").read_text()
        text = text.replace('height = 16\nprojection = "latlong"',
                            'height = 32\nprojection = "equidistant"\nfocal_px = [10, 10]')
        (capture / "capture.toml").write_text(text)
        seen = self.run_json("hdr", "environment", capture, "-o", self.root / "seen.exr")
        self.assertTrue(.5 < seen["coverage"] < .7, seen)
        light = self.run_json("light", "estimate", self.root / "seen.exr")
        self.assert_close(light["coverage"], seen["coverage"], .03)
        mean = light["mean_radiance"][1]
        known = self.run_json("light", "estimate", self.root / "seen.exr", "--projection", "latlong")
        self.assert_close(known["mean_radiance"][1], mean, .01 * mean)
        self.expect_refusal(["seen.hdr", "write .exr"], "hdr", "environment", capture, "-o", self.root / "seen.hdr")
        summary = self.run_json("composite", "--capture", capture, "--scene", self.root / "scene.toml",
                                "--out", self.root / "fisheye-out")
        self.assert_close(summary["configuration"]["coverage"], seen["coverage"], 1e-6)

    def test_no_error_is_promised_over_a_saturated_sun(self):
        files.write_sun_hdr(self.root / "sun.hdr", 256, 128, 3e3)
        record = self.root / "sunny"
        known = self.run_json("demo", "--headless", "--frames", 6, "--width", 160, "--height", 90, "--out",
                              self.root / "sunny-out", "--asset", "builtin:box", "--no-turntable", "--environment",
                              self.root / "sun.hdr", "--record", record)["configuration"]["plan"]
        self.assertEqual((known["lower_bound"], known["within_budget"]), (False, True), "recovered from the floor")
        self.assertGreater(known["predicted_error"], 0)
        # The same frames with a floor of which nobody knows the albedo.
        scene = record / "unknown-floor.toml"
        text = (record / "scene.toml").read_text()
        at = text.index("albedo", text.index("[[real]]"))
        scene.write_text(text[:at] + text[text.index("\n", at) + 1:])
        unknown = self.run_json("composite", "--capture", record, "--scene", scene, "--coarse", "--out",
                                self.root / "unknown")["configuration"]["plan"]
        self.assertEqual((unknown["lower_bound"], unknown["within_budget"]), (True, False))
        self.assertIsNone(unknown["predicted_error"])
        self.assertIn("at least", unknown["why"])

    def test_a_live_run_tells_its_processor_time(self):
        # For as long as the bracket may take on a busy machine.
        spent = self.run_json("demo", "--headless", "--live", "--frames", 90, "--width", 160, "--height", 90,
                              "--no-turntable", "--asset", "builtin:box", "--out", self.root / "live")["processor"]
        self.assertEqual(set(spent), {f"{of}_ms" for of in ("pipeline", "drawing", "cameras", "encoding", "other")})
        self.assertGreater(spent["pipeline_ms"], 0)
        self.assertGreater(spent["encoding_ms"], 0)
        self.assertTrue(all(ms >= 0 for ms in spent.values()), spent)

    def test_record_is_refused_before_the_work_and_leftovers_are_not_results(self):
        record, out = self.root / "again", self.root / "again-out"
        record.mkdir()
        (record / "capture.toml").write_text("earlier")
        self.expect_refusal(["already holds"], "demo", "--headless", "--frames", 1, "--width", 64, "--height", 64,
                            "--out", self.root / "out" / "demo", "--record", record)
        self.assertEqual([p.name for p in record.iterdir()], ["capture.toml"])
        # A killed run of the same process number left a folder: what is in it is not this run's.
        out.mkdir()
        script = f'mkdir "{out}"/.partial-$$ && echo stale > "{out}"/.partial-$$/frame_000099.png && exec "$@"'
        done = subprocess.run(["sh", "-c", script, "sh", program(), "demo", "--headless", "--frames", "1", "--width", "64",
                               "--height", "64", "--no-turntable", "--asset", "builtin:box", "--bands", "1", "--out",
                               str(out)],
                              env=self.environment, capture_output=True, text=True, timeout=300 * PATIENCE, check=False)
        if done.returncode == 2 and re.search(r"EGL|OpenGL ES", done.stderr):
            self.skipTest("no OpenGL ES 3.1: " + done.stderr.strip())
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(sorted(p.name for p in out.iterdir()), ["camera.png", "still.png", "summary.json", "video.mp4"])
        silent = self.root / "silent"
        self.run_well("demo", "--headless", "--frames", 2, "--width", 64, "--height", 64, "--no-turntable", "--bands", 1,
                      "--asset", "builtin:box", "--no-video", "--out", silent)
        self.assertEqual(sorted(p.name for p in silent.iterdir()), ["camera.png", "still.png", "summary.json"])

    def test_stopped_composite_leaves_the_earlier_results_alone(self):
        record, out = self.root / "long", self.root / "kept"
        self.run_well("demo", "--headless", "--frames", 60, "--width", 320, "--height", 180, "--out",
                      self.root / "d", "--asset", "builtin:box", "--no-turntable", "--record", record)
        out.mkdir()
        for name in ("video.mp4", "frame_000000.png", "summary.json"):
            (out / name).write_text("earlier")
        process = subprocess.Popen([program(), "composite", "--capture", record, "--scene", record / "scene.toml",
                                    "--coarse", "--out", out], env=self.environment, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 120 * PATIENCE
        partial = out / f".partial-{process.pid}"
        # One name, not a pattern: a pattern fails on a folder that goes while it is read.
        while not (partial / "frame_000000.png").exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(.005)
        process.send_signal(signal.SIGTERM)
        errors = process.communicate(timeout=60 * PATIENCE)[1]
        self.assertEqual(process.returncode, 2, errors)
        self.assertIn("stopped by a signal", errors)
        self.assertEqual(sorted(p.name for p in out.iterdir()), ["frame_000000.png", "summary.json", "video.mp4"])
        for p in out.iterdir():
            self.assertEqual(p.read_text(), "earlier")


class LightEstimate(CliTest):
    @classmethod
    def make_files(cls):
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))

    def test_constant_environment_has_its_mean_alone(self):
        for bands in (1, 3, 9):
            light = self.run_json("light", "estimate", self.root / "even.hdr", "--bands", bands)
            self.assertEqual(light["bands"], bands)
            self.assertEqual(len(light["coefficients"]), bands * bands)
            for n, triple in enumerate(light["coefficients"]):
                for value, radiance in zip(triple, (1.0, 0.5, 0.25)):
                    self.assert_close(value, radiance * math.sqrt(4 * math.pi) if n == 0 else 0, 0.01 * radiance)
            self.assertEqual(light["lights"], [])
            for value, radiance in zip(light["mean_radiance"], (1.0, 0.5, 0.25)):
                self.assert_close(value, radiance, 0.01 * radiance)
            self.assert_close(light["coverage"], 1, 1e-6)
            self.assertEqual(light["clipped_fraction"], 0)
            self.assertIsNone(light["uncertainty"]["noise"], "of one map")
            self.assert_close(light["uncertainty"]["irradiance"], 0, 1e-6)
            if bands == 9:
                self.assertIsNone(light["truncation_error"], "nothing beyond is measured")
            else:
                self.assert_close(light["truncation_error"], 0, 1e-3)

    def test_auto_takes_the_fewest_bands(self):
        self.assertEqual(self.run_json("light", "estimate", self.root / "even.hdr")["bands"], 1)

    def test_bad_bands_and_projections_are_refused(self):
        for bands in ("0", "10", "two", "2.5", ""):
            self.expect_refusal(["bands"], "light", "estimate", self.root / "even.hdr", "--bands", bands)
        self.expect_refusal(["projection"], "light", "estimate", self.root / "even.hdr", "--projection", "flat")


class HdrMerge(CliTest):
    @classmethod
    def make_files(cls):
        # Linear codes of radiance 40 at 1/400, 1/100 and 1/25 s: .1, .4, clipped; in part a tenth of it.
        for name, code in (("a", 25.5), ("b", 102), ("c", 408)):
            files.write_png(cls.root / f"{name}.png", 20, 10,
                            lambda x, y, c=code: (min(255, round(c * (1 if x < 10 else 0.1))),) * 3)

    def test_times_come_from_the_cameras_own_words(self):
        pictures = sorted(self.shared_folder("eval-only/stacks/pingpong").glob("*.JPG"))
        told, by_exif = self.root / "told.exr", self.root / "by_exif.exr"
        self.run_well("hdr", "merge", *pictures, "--times", "0.001,0.004,1/60", "--response", "srgb", "-o", told)
        self.run_well("hdr", "merge", *pictures, "--response", "srgb", "-o", by_exif)
        self.assertEqual(told.read_bytes(), by_exif.read_bytes())

    def test_bracket_gives_its_radiance(self):
        images = [self.root / f"{n}.png" for n in "abc"]
        out = self.root / "merged.hdr"
        report = self.run_json("hdr", "merge", *images, "--times", "1/400,0.01,0.04", "--response", "linear", "-o", out)
        self.assertLessEqual({"width", "height", "exposures_used", "clipped_fraction", "black_fraction"}, set(report))
        self.assertEqual((report["width"], report["height"], report["exposures_used"]), (20, 10, 3))
        self.assertEqual(report["clipped_fraction"], 0)
        picture = self.run_json("inspect", out)
        self.assert_close(picture["largest_luminance"], 40, 0.8)
        self.assert_close(picture["smallest_positive_luminance"], 4, 0.12)

    def test_unknown_time_is_found_from_the_overlap(self):
        for name, factor in (("short", 1), ("long", 2)):
            files.write_png(self.root / f"{name}.png", 80, 60, lambda x, y, f=factor: (f * (30 + x),) * 3)
        pictures = [self.root / "short.png", self.root / "long.png"]
        for times in ("0.01,?", "?,0.02"):
            out = self.root / "found.hdr"
            done = self.run_program("hdr", "merge", *pictures, "--times", times, "--response", "linear", "-o", out)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertRegex(done.stderr, r"(short|long)\.png: .* times .* by their overlap .*: 0\.0[12]\d* s")
            self.assert_close(self.run_json("inspect", out)["largest_luminance"], 109 / 255 / 0.01, 0.2)
        done = self.run_program("hdr", "merge", *pictures, "--times", "0.01,0.04", "--response", "linear", "-o", out)
        self.assertRegex(done.stderr, "warning: .*long.png: 2 times .*, but 4 by the given times")
        told, = self.run_json("hdr", "merge", *pictures, "--times", "0.01,0.04", "--response", "linear", "-o",
                              out)["exposure_ratios"]
        self.assertEqual((told["picture"], told["against"]), (str(pictures[1]), str(pictures[0])))
        self.assert_close(told["labelled_ratio"], 4, 1e-9)
        self.assertTrue(told["low"] <= 2.001 and told["high"] >= 1.999, told)
        self.assertLess(told["high"], 2.1)

    def test_times_of_linear_pictures_are_checked_by_their_overlap_too(self):
        for name, factor in (("dim", 1), ("double", 2)):
            files.write_png(self.root / f"{name}.png", 80, 60, lambda x, y, f=factor: (f * (30 + x),) * 3)
            self.run_well("hdr", "merge", self.root / f"{name}.png", "--times", "1", "--response", "linear", "-o",
                          self.root / f"{name}.exr")
        pictures, out = [self.root / "dim.exr", self.root / "double.exr"], self.root / "linear.hdr"
        done = self.run_program("hdr", "merge", *pictures, "--times", "0.01,0.04", "-o", out)
        self.assertRegex(done.stderr, r"warning: .*double.exr: (2|1\.99\d*|2\.0\d*) times .*, but 4 by the given times")
        right = self.run_program("hdr", "merge", *pictures, "--times", "0.01,0.02", "-o", out)
        self.assertEqual((right.returncode, "warning" in right.stderr), (0, False), right.stderr)
        self.run_well("hdr", "merge", *pictures, "--times", "0.01,?", "--response", "linear", "-o", out)
        self.assert_close(self.run_json("inspect", out)["largest_luminance"], 109 / 255 / 0.01, 0.3)

    def test_a_camera_that_moved_is_said_and_its_ratios_are_of_what_is_the_same(self):
        draw = random.Random(4)
        stones = [[.05 * 30 ** draw.random() for _ in range(60)] for _ in range(40)]
        pictures = []
        for k, (time, moved) in enumerate(((1, 0), (2, 11), (4, 5))):
            pictures.append(self.root / f"moved{k}.png")

            def codes(x, y, time=time, moved=moved):
                light = stones[(y + 20) // 8][(x + 40 - moved) // 8] * time
                return [round(255 * min(1, light * g) ** (1 / 2.2)) for g in (.4, .5, .6)]
            files.write_png(pictures[-1], 200, 120, codes)
        command = ["hdr", "merge", *pictures, "--times", "1,2,4", "-o", self.root / "moved.hdr"]
        said = self.run_program(*command).stderr
        self.assertRegex(said, r"warning: .*moved0.png and .*moved1.png: the camera moved by about 1[01] px; --align")
        self.assertEqual(said.count("warning"), 1, said)
        for told in self.run_json(*command)["exposure_ratios"]:
            self.assertTrue(told["low"] <= 2 <= told["high"], told)
            self.assert_close(told["ratio"], 2, .1)

    def test_ratios_of_a_stack_held_by_hand_hold_what_its_camera_says(self):
        pictures = sorted(self.shared_folder("eval-only/stacks/pingpong").glob("*.JPG"))
        for told in self.run_json("hdr", "merge", *pictures, "-o", self.root / "hand.exr")["exposure_ratios"]:
            self.assertTrue(told["low"] <= told["labelled_ratio"] <= told["high"], told)
            self.assert_close(told["ratio"] / told["labelled_ratio"], 1, .06)

    def test_unknown_time_is_refused_where_hardly_anything_is_well_exposed_in_both(self):
        # Four in a thousand patches of the picture lie between black and white in both.
        for name, lit in (("few-a", 32), ("few-b", 64)):
            files.write_png(self.root / f"{name}.png", 320, 240,
                            lambda x, y, lit=lit: (lit + x % 4,) * 3 if x < 36 and y < 8 else (0, 0, 0))
        out = self.root / "few.hdr"
        self.expect_refusal(["the ? of picture 2", "well exposed"], "hdr", "merge", self.root / "few-a.png",
                            self.root / "few-b.png", "--times", "0.01,?", "--response", "linear", "-o", out)
        self.assertFalse(out.exists())

    def test_order_of_the_images_does_not_matter(self):
        outs = [self.root / "one.hdr", self.root / "two.hdr"]
        for out, names, times in zip(outs, ("abc", "cab"), ("1/400,0.01,0.04", "0.04,1/400,0.01")):
            self.run_well("hdr", "merge", *[self.root / f"{n}.png" for n in names], "--times", times, "--response",
                          "linear", "-o", out)
        self.assert_close(self.run_json("compare", *outs)["rel_rmse"], 0, 1e-3)


class Bake(CliTest):
    def test_built_in_object_gives_a_file_that_inspect_knows(self):
        out = self.root / "ball.glb"
        report = self.run_json("bake", "builtin:ball", "-o", out, "--bands", 2, "--bounces", 1, "--samples", 64)
        keys = {"vertices", "texels", "coefficients", "rays", "seconds", "rays_per_second", "standard_error", "bytes"}
        self.assertLessEqual(keys, set(report))
        self.assertEqual(report["coefficients"], 4)
        self.assertEqual(report["bytes"], out.stat().st_size)
        self.assertGreater(report["rays"], report["vertices"])
        self.assertTrue(0 < report["standard_error"] < 0.2)
        known = self.run_json("inspect", out)
        self.assertEqual((known["kind"], known["bands"], known["vertices"]), ("baked object", 2, report["vertices"]))
        memory = known["memory"]
        self.assertEqual(memory, report["memory"])
        parts = [memory.pop(name + "_mb") for name in ("mesh", "surface", "ground", "shadow", "visibility")]
        self.assertGreater(min(parts), 0)
        self.assert_close(memory["without_lights_mb"], sum(parts), 1e-9)
        # A light keeps a map of 256 x 256 and a number by vertex; both of 4 bytes.
        self.assert_close(memory["a_light_mb"], 4 * (256**2 + known["vertices"]) / 1e6, 1e-9)
        # By texel 4 coefficients of 2 bytes, texels in blocks of 64.
        self.assert_close(parts[3], 8 * -(-report["texels"] // 64) * 64 / 1e6, 1e-9)
        # Places, normals, albedo; and triangles: 12 bytes each.
        self.assert_close(parts[0], (36 * known["vertices"] + 12 * known["triangles"]) / 1e6, 1e-9)

    def bake_clip(self, name, *more):
        return ("bake", "builtin:walker", "--animation", "Walk", "-o", self.root / name, "--fps", 6, "--bands", 2,
                "--bounces", 1, "--samples", 64, "--ground-texels", 16, *more)

    def test_a_clip_in_shards_is_the_same_file(self):
        whole = self.run_json(*self.bake_clip("whole.shlm"))
        self.assertEqual((whole["clip"], whole["coefficients"]), ("Walk", 4))
        self.assertEqual(whole["frames"] - whole["frames_between"], 7)  # a second, six a second
        self.assertGreater(whole["frames_between"], 0)  # a walk's legs do not go in straight lines
        self.assertLess(whole["compression_error"], 0.0051)
        self.assertEqual(whole["bytes"], (self.root / "whole.shlm").stat().st_size)
        for shard in (2, 1):
            self.run_json(*self.bake_clip("merged.shlm", "--shard", f"{shard}/2"))
        self.run_json(*self.bake_clip("merged.shlm", "--merge", 2))
        self.assertEqual((self.root / "merged.shlm").read_bytes(), (self.root / "whole.shlm").read_bytes())
        self.assertEqual([p.name for p in self.root.glob("*.shlm*") if p.suffix != ".shlm"], [])  # journals, shards
        self.assertEqual(self.run_json("inspect", self.root / "whole.shlm")["kind"], "baked clip")

    def test_a_clip_that_cannot_be_baked_is_refused_and_leaves_nothing(self):
        for words, more in ((["--shard", "3/2"], ["--shard", "3/2"]), (["--light-map", "12"], ["--light-map", "12"]),
                            (["--samples"], ["--samples", 65]), (["-albedo"], ["--receiver-albedo", "nan"]),
                            (["Walk, Wave, Rest"], ["--animation", "Fly"]), (["bad.glb", ".shlm"], ["-o", "bad.glb"])):
            arguments = list(self.bake_clip("bad.shlm"))
            for key, value in zip(more[::2], more[1::2]):
                if key in arguments:
                    arguments[arguments.index(key) + 1] = value
                else:
                    arguments += [key, value]
            self.expect_refusal(words, *arguments)
            self.assertEqual(list(self.root.glob("bad*")), [])
        self.expect_refusal(["shard-1-of-2"], *self.bake_clip("none.shlm", "--merge", 2))


class Charts(CliTest):
    def test_coders_of_a_clip_are_charted(self):
        out = self.root / "clip"
        chart = self.run_json("chart", "--animation", "Walk", "--frames", 6, "--samples", 64, "--light-map", "48x48",
                              "--out", out)
        coders = {row["coder"] for row in chart["rows"]}
        self.assertEqual(len(coders), 4)
        for coder in coders:
            rows = sorted((row["bytes"], row["rendered_rel_rmse"]) for row in chart["rows"] if row["coder"] == coder)
            self.assertGreater(rows[0][1], rows[-1][1], coder)  # more bytes, less error
        self.assertTrue((out / "rate-distortion.csv").stat().st_size > 0)

    def test_coders_of_a_light_track_are_charted(self):
        out = self.root / "track"
        files.write_sun_hdr(self.root / "sky.hdr", 64, 32, 400)
        rows = self.run_json("chart", "--light-track", "--environment", self.root / "sky.hdr", "--out", out)["rows"]
        ours = rows[0]
        self.assertIn("ours", ours["coder"])
        self.assertLess(ours["irradiance_rel_rmse"], .005)
        self.assertLess(ours["bytes"], 256 * 128 * 3 * 4 / 200)
        self.assertEqual(len({row["coder"] for row in rows}), 6)
        for coder in {row["coder"] for row in rows[1:]}:
            own = sorted((row["bytes"], row["irradiance_rel_rmse"]) for row in rows if row["coder"] == coder)
            self.assertGreater(own[0][1], own[-1][1], coder)  # more bytes, less error
        self.assertTrue((out / "rate-distortion.csv").stat().st_size > 0)

    def test_ways_to_mirror_are_charted(self):
        out = self.root / "materials"
        rows = self.run_json("chart", "--materials", "--asset", "builtin:ball", "--error", .2, "--out", out)["rows"]
        materials = {row["material"] for row in rows}
        self.assertEqual(materials, {"chrome", "gold", "brushed steel", "plastic"})
        for material in materials:
            own = [row for row in rows if row["material"] == material]
            self.assertEqual(len(own), 9)
            best = {m: min(row["object_rel_rmse"] for row in own if row["method"] == m)
                    for m in ("as chalk", "surroundings mirrored", "objects too")}
            self.assertLess(best["surroundings mirrored"], .4 * best["as chalk"], material)
            # A ball alone mirrors no object.
            self.assertAlmostEqual(best["objects too"], best["surroundings mirrored"], delta=.02, msg=material)
            self.assertTrue(all(row["frame_ms"] > 0 and row["light_ms"] > 0 for row in own))
        self.assertTrue((out / "materials.svg").stat().st_size > 1000)
        self.assertIn("gold", (out / "materials.csv").read_text())
        self.expect_refusal(["--materials", "--bands"], "chart", "--materials", "--bands", 3)
        self.expect_refusal(["absent.obj"], "chart", "--materials", "--asset", "absent.obj",
                            "--out", self.root / "none")

    def test_ways_to_trace_a_light_are_charted(self):
        out = self.root / "ways"
        rows = self.run_json("chart", "--direct-light", "--asset", "builtin:walker", "--out", out)["rows"]
        radii = {row["light_radius_deg"] for row in rows}
        self.assertEqual(len(radii), 4)
        for radius in radii:
            def errors(method):
                return [row["irradiance_rel_rmse"] for row in rows
                        if row["light_radius_deg"] == radius and row["method"] == method]
            every, needed, cached = (errors(m) for m in ("rays at every vertex", "rays where needed",
                                                         "cached visibility, 16 rays"))
            self.assertEqual(every, sorted(every, reverse=True))  # more rays, less error
            self.assertEqual(cached, sorted(cached))  # a larger error allowed
            for i, error in enumerate(needed):
                self.assertLess(error, 1.06 * every[i + 1] + .002, (radius, i))  # as many rays
            self.assertLess(max(errors("visibility map")), .06)
        self.assertIn("walker", (out / "direct-light.csv").read_text())
        self.assertTrue((out / "direct-light.svg").stat().st_size > 1000)
        traced = [row["traced_fraction"] for row in rows if row["method"].startswith("cached")]
        self.assertLess(min(traced), .1)
        self.assertTrue(all(row["traced_fraction"] is None for row in rows if row["method"] == "visibility map"))
        for flags in (["--bands", 3], ["--environment", "x.hdr"], ["--slurm"], ["--shard", "1/2"]):
            self.expect_refusal(["--direct-light", flags[0]], "chart", "--direct-light", *flags)
        self.expect_refusal(["absent.obj"], "chart", "--direct-light", "--asset", "builtin:knot", "absent.obj",
                            "--out", self.root / "none")
        self.expect_refusal(["--asset", "builtin:box twice"], "chart", "--direct-light", "--asset", "builtin:box",
                            "builtin:box", "--out", self.root / "none")
        self.assertFalse((self.root / "none").exists())

    def test_lights_are_charted(self):
        out = self.root / "lights"
        with_sun = self.run_json("chart", "--asset", "builtin:box", "--bands", 5, "--max-lights", 2, "--error", 0.03,
                                 "--out", out)["rows"]
        self.assertEqual([row["environment"] for row in with_sun], ["room", "clear-sky"])
        without = self.run_json("chart", "--asset", "builtin:box", "--bands", 5, "--max-lights", 0, "--error", 0.03,
                                "--out", self.root / "harmonics")["rows"]
        for disc, harmonics in zip(with_sun, without):
            self.assertEqual((disc["coefficients"], disc["lights_allowed"], harmonics["lights"]), (25, 2, 0))
            self.assertGreater(disc["lights"], 0)
            self.assertGreater(disc["light_update_p50_ms"], 0)
            self.assertGreater(disc["memory_bytes"], harmonics["memory_bytes"])
        self.assertLess(2 * with_sun[1]["shadow_rmse"], without[1]["shadow_rmse"])  # the reference's noise, .03, on both
        with (out / "accuracy.csv").open() as table:
            rows = list(csv.DictReader(table))
        self.assertEqual(set(rows[0]), set(with_sun[0]))
        for name in ("error-time.svg", "error-time-room.svg", "error-time-clear-sky.svg"):
            self.assertIn("</svg>", (out / name).read_text())
        self.expect_refusal(["--bands", "1..9"], "chart", "--bands", 10, "--out", self.root / "none")
        self.expect_refusal(["absent.hdr"], "chart", "--environment", self.root / "absent.hdr", "--out", self.root / "none")
        self.assertFalse((self.root / "none").exists())


class Render(CliTest):
    @classmethod
    def make_files(cls):
        files.write_scene(cls.root)
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))

    def render(self, name, *more, camera="camera.toml"):
        out = self.root / name
        self.run_json("render", "--scene", self.root / "scene.toml", "--environment", self.root / "even.hdr",
                      "--camera", self.root / camera, "-o", out, *more)
        return out

    def test_composite_agrees_with_the_path_traced_reference(self):
        empty, truth_empty = self.render("e.exr", "--without-objects"), self.render("te.exr", "--without-objects",
                                                                                   "--reference", "--error", 0.02)
        self.assert_close(self.run_json("compare", empty, truth_empty)["rel_rmse"], 0, 0.03)
        ours, truth = self.render("o.exr"), self.render("t.exr", "--reference", "--error", 0.02)
        wrong = self.run_json("compare", ours, truth)["rel_rmse"]
        drawn = self.run_json("compare", truth, empty)["rel_rmse"]
        self.assertGreater(drawn, 0.05, "nothing drawn")
        self.assertLess(wrong, 0.3 * drawn)

    def test_metal_mirrors_the_environment(self):
        files.write_mirror(self.root / "mirror.gltf")
        files.write_striped_hdr(self.root / "striped.hdr", 512, 256)
        scene = (self.root / "scene.toml").read_text().replace("albedo = [0.6, 0.6, 0.6]", "")
        (self.root / "mirror.toml").write_text(scene.replace("cube.obj", "mirror.gltf"))
        pictures = []
        for name, *more in (("m.exr",), ("mt.exr", "--reference", "--error", 0.02), ("me.exr", "--without-objects")):
            pictures.append(self.root / name)
            self.run_json("render", "--scene", self.root / "mirror.toml", "--environment", self.root / "striped.hdr",
                          "--camera", self.root / "camera.toml", "-o", pictures[-1], *more)
        ours, truth, empty = pictures
        drawn = self.run_json("compare", truth, empty)["rel_rmse"]
        self.assertGreater(drawn, 0.1, "nothing drawn")
        self.assertLess(self.run_json("compare", ours, truth)["rel_rmse"], 0.2 * drawn)

    def test_a_fisheyes_picture_is_that_of_the_world_through_it(self):
        text = (self.root / "camera.toml").read_text().replace("width = 64", "width = 192").replace("= 48", "= 144")
        for name, lens in (("pinhole", 'projection = "pinhole"\nfocal_px = [90, 90]'),
                           ("fisheye", 'projection = "kb4"\nfocal_px = [90, 90]\ndistortion = [-0.02, 0.004, 0, 0]')):
            (self.root / f"{name}.toml").write_text(re.sub(r'projection = "pinhole"\nfocal_px.*', lens, text))
        empty, ours, truth = (self.render(name, *more, camera="fisheye.toml") for name, *more in (
            ("fe.exr", "--without-objects"), ("fo.exr",), ("ft.exr", "--reference", "--error", 0.006)))
        self.assertGreater(self.run_json("compare", truth, empty)["rel_rmse"], 0.02, "nothing drawn")
        self.assertLess(self.run_json("compare", ours, truth)["rel_rmse"],
                        0.3 * self.run_json("compare", truth, empty)["rel_rmse"])
        self.assertGreater(self.run_json("compare", ours, self.render("p.exr", camera="pinhole.toml"))["rel_rmse"],
                           0.02, "as a pinhole")


class Files(CliTest):
    @classmethod
    def make_files(cls):
        files.write_scene(cls.root)
        files.write_capture(cls.root / "capture")
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))
        files.write_png(cls.root / "a.png", 9, 7, lambda x, y: (x, y, 200))
        files.write_png(cls.root / "b.png", 9, 7, lambda x, y: (x, y, 201))
        files.write_png(cls.root / "other.png", 9, 7, lambda x, y: (200, 180, 20))
        files.write_png(cls.root / "wide.png", 9, 7, lambda x, y: (1000 * x, y, 2), bits=16)

    def test_inspect_knows_every_kind(self):
        for name, kind in (("a.png", "8-bit picture"), ("wide.png", "16-bit picture"), ("even.hdr", "HDR picture"),
                           ("cube.obj", "mesh"), ("scene.toml", "scene"), ("camera.toml", "camera"),
                           ("capture", "capture folder")):
            self.assertEqual(self.run_json("inspect", self.root / name)["kind"], kind, name)
        self.assertEqual([c["frames"] for c in self.run_json("inspect", self.root / "capture")["cameras"]], [2, 3])
        manifest = self.run_json("inspect", self.root / "capture" / "capture.toml")
        self.assertEqual([c["frames"] for c in manifest["cameras"]], [2, 3])

    def test_inspect_reads_every_kind_of_mesh_that_an_object_may_be(self):
        corners = ("0 0 0", "1 0 0", "0 0 1")
        stl = "facet normal 0 1 0\nouter loop\n" + "".join(f"vertex {c}\n" for c in corners) + "endloop\nendfacet\n"
        axes = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
        dae = ('<?xml version="1.0"?>\n<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
               '<asset><up_axis>Y_UP</up_axis></asset><library_geometries><geometry id="g"><mesh><source id="p">'
               f'<float_array id="a" count="9">{" ".join(corners)}</float_array><technique_common>'
               f'<accessor source="#a" count="3" stride="3">{axes}</accessor></technique_common></source>'
               '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="1">'
               '<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>'
               '</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">'
               '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes><scene>'
               '<instance_visual_scene url="#s"/></scene></COLLADA>\n')
        for name, text in (("one.stl", f"solid one\n{stl}endsolid one\n"), ("ONE.STL", f"solid one\n{stl}endsolid one\n"),
                           ("one.dae", dae)):
            (self.root / name).write_text(text)
            mesh = self.run_json("inspect", self.root / name)
            self.assertEqual((mesh["kind"], mesh["triangles"], mesh["size_m"]), ("mesh", 1, [1, 0, 1]), name)

    def test_inspect_tells_materials_and_what_is_left_out_of_a_gltf(self):
        corners = base64.b64encode(struct.pack("<9f", 0, 0, 0, 30, 0, 0, 0, 15, 0)).decode()
        gold = {"name": "gold", "pbrMetallicRoughness": {"baseColorFactor": [1, 0.75, 0.25, 1],
                                                         "roughnessFactor": 0.25}}
        (self.root / "gold.gltf").write_text(json.dumps({
            "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "extensionsUsed": ["VENDOR_sparkle"], "materials": [gold],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": f"data:application/octet-stream;base64,{corners}"}]}))
        told = self.run_json("inspect", self.root / "gold.gltf")
        self.assertEqual(told["materials"], [{
            "name": "gold", "kind": "metal", "base_colour": [1, 0.75, 0.25], "metallic": 1, "roughness": 0.25,
            "alpha": "opaque", "emission": [0, 0, 0], "maps": []}])
        self.assertEqual(told["likely_unit"], "centimetres")
        self.assertEqual(told["extensions"], ["VENDOR_sparkle"])
        self.assertEqual(told["left_out"], ["extension VENDOR_sparkle is not read"])
        self.assertEqual(told["textures"], [])

    def test_inspect_tells_the_figures_of_calibrations(self):
        pose = "[1,0,0,0, 0,1,0,0, 0,0,1,0, 0.5,0.8,1.75,1]"
        cases = (
            ("lens", '[[camera]]\nname = "lens"\nrole = "environment"\nwidth = 640\nheight = 480\nprojection = "kb4"\n'
             "focal_px = [218, 217]\ndistortion = [0.04, -0.01, 0, 0]\n[calibration]\nrms_px = 0.25\n",
             {"kind": "camera", "focal_px": [218, 217], "principal_px": [320, 240],
              "distortion": [0.04, -0.01, 0, 0], "rms_px": 0.25}),
            ("response", "decode = [0, 0.25, 1]\n",
             {"kind": "response", "channels": 1, "light_at_half_code": [0.25, 0.25, 0.25]}),
            ("noise", "[noise]\nfull_well_electrons = 15400\nread_noise = 0.0005\nblack_level = 0.0625\n",
             {"kind": "noise", "full_well_electrons": 15400, "read_noise": 0.0005, "black_level": 0.0625}),
            ("vignetting", "[vignetting]\nterms = [-0.5, 0.25, 0]\n",
             {"kind": "vignetting", "terms": [-0.5, 0.25, 0], "corner": 0.75}),
            ("colour", "[colour]\nmatrix = [1, 0, 0.5, 0, 1, 0, 0, 0, 2]\nrms = 0.01\n",
             {"kind": "colour", "matrix": [[1, 0, 0.5], [0, 1, 0], [0, 0, 2]], "rms": 0.01}),
            ("poses", f'[rig]\nframe = "board"\nrms_px = 0.2\n[[camera]]\nname = "left"\nworld_from_camera = {pose}\n',
             {"kind": "poses", "frame": "board", "rms_px": 0.2,
              "cameras": [{"name": "left", "position_m": [0.5, 0.8, 1.75]}]}))
        for name, text, figures in cases:
            path = self.root / f"{name}-figures.toml"
            path.write_text("version = 1\n" + text)
            told = self.run_json("inspect", path)
            self.assertEqual({key: told.get(key) for key in figures}, figures)
            path.write_text("version = 2\n" + text)
            self.expect_refusal([path.name, "version"], "inspect", path)

    def test_inspect_knows_a_rig_with_and_without_a_scene(self):
        camera = ('[[camera]]\nname = "webcam"\nrole = "view"\ndevice = "/dev/video7"\nwidth = 64\nheight = 48\n'
                  'projection = "pinhole"\nresponse = "srgb"\nexposures_s = [0.01]\n')
        path = self.root / "rig-alone.toml"
        for capture, source in (('[capture]\nsource = "cameras"\n', "cameras"), ("", None)):
            path.write_text("version = 1\n" + capture + camera)
            rig = self.run_json("inspect", path)
            self.assertEqual((rig["kind"], rig.get("source"), rig["scene"]), ("rig", source, None))
            self.assertEqual([(c["name"], c["device"], c["exposures_s"]) for c in rig["cameras"]],
                             [("webcam", "/dev/video7", [0.01])])
        path.write_text('version = 1\n[capture]\nsource = "studio"\n[scene]\nfile = "scene.toml"\n')
        rig = self.run_json("inspect", path)
        self.assertEqual((rig["kind"], rig["source"], rig["scene"], rig["cameras"]), ("rig", "studio", "scene.toml", []))

    def test_inspect_names_what_it_understands(self):
        (self.root / "notes.txt").write_text("nothing of ours")
        self.expect_refusal(["notes.txt", "a picture (PNG", "a mesh (glTF", "a recording"], "inspect",
                            self.root / "notes.txt")
        (self.root / "other.toml").write_text("version = 1\n[package]\nname = \"x\"\n")
        self.expect_refusal(["other.toml", "scene, rig", "noise"], "inspect", self.root / "other.toml")
        self.expect_refusal(["absent.txt", "no such file"], "inspect", self.root / "absent.txt")

    def test_compare_measures_the_difference(self):
        keys = {"rel_rmse", "log10_rmse", "psnr_db", "max_abs", "flip"}
        same = self.run_json("compare", self.root / "a.png", self.root / "a.png")
        self.assertLessEqual(keys, set(same))
        self.assertEqual((same["rel_rmse"], same["log10_rmse"], same["max_abs"]), (0, 0, 0))
        other = self.run_json("compare", self.root / "a.png", self.root / "b.png")
        self.assert_close(other["max_abs"], 1 / 255, 1e-6)
        self.assertGreater(other["rel_rmse"], 0)
        self.assertEqual(same["flip"], 0)
        # FLIP takes distances to the power of .7: a step of one code of blue counts for .03.
        self.assertTrue(0 < other["flip"] < 0.05, other["flip"])
        visible = self.run_json("compare", self.root / "a.png", self.root / "other.png")["flip"]
        self.assertTrue(0.1 < visible <= 1, visible)

    def test_compare_refuses_pictures_of_different_sizes(self):
        self.expect_refusal(["even.hdr"], "compare", self.root / "even.hdr", self.root / "a.png")


def with_environment(exr):
    """An OpenEXR file with the standard attribute of a lat-long map before its others, its line
    offsets moved by as much."""
    attribute = b"envmap\0envmap\0\x01\0\0\0\0"
    end = 8  # magic and version; then name, type, size, value
    while exr[end] != 0:
        end = exr.index(b"\0", exr.index(b"\0", end) + 1) + 1
        end += 4 + struct.unpack_from("<I", exr, end)[0]
    first, = struct.unpack_from("<Q", exr, end + 1)
    count = (first - end - 1) // 8
    offsets = [at + len(attribute) for at in struct.unpack_from(f"<{count}Q", exr, end + 1)]
    return exr[:8] + attribute + exr[8:end + 1] + struct.pack(f"<{count}Q", *offsets) + exr[first:]


class Encode(CliTest):
    @classmethod
    def make_files(cls):
        files.write_sun_hdr(cls.root / "sun.hdr", 128, 64, 20000)

    def test_a_sky_that_is_coded_lights_as_the_one_that_is_not(self):
        sky = self.root / "sun.hdr"
        for name in ("sun.jph", "sun.jp2", "sun.pnr"):
            coded = self.root / name
            report = self.run_json("encode", sky, "-o", coded, "--error", 2)
            self.assertEqual(report["bytes"], coded.stat().st_size)
            self.assertLess(report["bytes"], sky.stat().st_size / 10)
            self.assertLessEqual(report["luminance_error_percent"], 2)
            self.assertLessEqual(report["light_error_percent"], 2)
            self.assertEqual(self.run_json("inspect", coded)["kind"], "HDR picture")
            self.run_json("tonemap", coded, "-o", self.root / "shown.png")
            light, truth = (self.run_json("light", "estimate", path, "--bands", 3) for path in (coded, sky))
            for own, true in zip(light["coefficients"], truth["coefficients"]):
                for channel, value in zip(own, true):
                    self.assertAlmostEqual(channel, value, delta=0.03 * abs(truth["coefficients"][0][0]))
            back = self.root / "back.exr"
            self.run_json("decode", coded, "-o", back)
            self.assertLess(self.run_json("compare", back, coded)["log10_rmse"], 1e-5)
            self.assertLess(self.run_json("compare", coded, sky)["log10_rmse"], 0.0087)

    def test_a_projection_that_the_shape_does_not_tell_is_kept(self):
        room, back = (self.root / name for name in ("room.exr", "room_back.exr"))
        self.run_json("decode", self.root / "sun.hdr", "-o", self.root / "plain.exr")
        room.write_bytes(with_environment((self.root / "plain.exr").read_bytes()))
        for name, *exact in (("room.jph",), ("room.jph", "--every-pixel"), ("room.pnr",), ("room.pnr", "--base", "lossless")):
            coded = self.root / name
            self.run_json("encode", room, "-o", coded, *exact)
            self.run_json("decode", coded, "-o", back)
            self.assertIn(b"envmap\0envmap\0\x01\0\0\0\0", back.read_bytes())
        self.run_json("encode", self.root / "plain.exr", "-o", coded)
        self.run_json("decode", coded, "-o", back)
        self.assertNotIn(b"envmap", back.read_bytes())

    def test_size_and_exactness_are_kept(self):
        out = self.root / "small.jph"
        self.assertLessEqual(self.run_json("encode", self.root / "sun.hdr", "-o", out, "--size-kb", 1.2)["bytes"], 1200)
        exact = self.run_json("encode", self.root / "sun.hdr", "-o", out, "--error", 0.1, "--every-pixel")
        self.assertLessEqual(exact["worst_luminance_error_percent"], 0.1)

    def test_radiance_files_come_back_bit_for_bit(self):
        sun, coded, back = self.root / "sun.hdr", self.root / "exact.pnr", self.root / "exact.hdr"
        report = self.run_json("encode", sun, "-o", coded, "--base", "lossless")
        self.assertLess(report["bytes"], sun.stat().st_size / 3)
        self.assertEqual(report["worst_luminance_error_percent"], 0)
        self.run_json("decode", coded, "-o", back)
        self.assertEqual(self.run_json("compare", back, sun)["mse"], 0)

    def test_a_base_that_goes_on_takes_less_than_one_that_does_not(self):
        files.write_slope_hdr(self.root / "slope.hdr", 160, 60)
        own, printed = (self.run_json("encode", self.root / "slope.hdr", "-o", self.root / f"{base}.pnr", "--base", base)
                        for base in ("continuous", "adaptive"))
        self.assertLess(own["bytes"], printed["bytes"] / 1.5)

    def test_coders_of_pictures_are_charted(self):
        out = self.root / "stills"
        rows = self.run_json("chart", "--still", self.root / "sun.hdr", "--out", out)["rows"]
        coders = {row["coder"] for row in rows}
        self.assertEqual(len(coders), 13)
        for coder in [name for name in coders if "JPEG 2000" in name]:
            own = sorted((row["bytes"], row["log10_luminance_rms"]) for row in rows if row["coder"] == coder)
            self.assertGreaterEqual(own[0][1], own[-1][1], coder)  # more bytes, no more error
        piz = next(row for row in rows if row["coder"] == "OpenEXR PIZ")
        self.assertLess(piz["log10_luminance_rms"], 2.0**-11)  # floats of 16 bits
        whole, runs = (next(row for row in rows if word in row["coder"]) for word in ("arithmetic", "Radiance"))
        self.assertLess(whole["bytes"], runs["bytes"])
        for row in (whole, runs):
            self.assertLess(row["pixel_rel_max"], 1 / 127, row)  # eight bits, of which the first is set
        self.assertTrue((out / "rate-distortion.csv").stat().st_size > 0)
        self.assertEqual(len((out / "stills.csv").read_text().splitlines()), 1 + len(rows))
        self.expect_refusal(["none.hdr"], "chart", "--still", self.root / "none.hdr", "--out", out)

    def test_bad_input_is_one_line_and_leaves_nothing(self):
        sun, out = self.root / "sun.hdr", self.root / "bad.jph"
        for words, arguments in ((["bad.png", ".jph", ".jp2", ".pnr"], [sun, "-o", self.root / "bad.png"]),
                                 (["--base", ".pnr"], [sun, "-o", out, "--base", "adaptive"]),
                                 (["--every-pixel", ".jph"], [sun, "-o", self.root / "bad.pnr", "--every-pixel"]),
                                 (["--base", "lossless"],
                                  [sun, "-o", self.root / "bad.pnr", "--base", "lossless", "--error", 1]),
                                 (["--size-kb", "bytes at least"], [sun, "-o", self.root / "bad.pnr", "--size-kb", 0.1]),
                                 (["none.hdr"], [self.root / "none.hdr", "-o", out]),
                                 (["--error"], [sun, "-o", out, "--error", 0]),
                                 (["--size-kb", "bytes at least"], [sun, "-o", out, "--size-kb", 0.1]),
                                 (["--size-kb", "--every-pixel"], [sun, "-o", out, "--size-kb", 9, "--every-pixel"])):
            self.expect_refusal(words, "encode", *arguments)
        files.write_lamp_hdr(self.root / "lamp.hdr", 40, 30, [5, 4, 1])
        self.expect_refusal(["--error", "the best that this coder reaches", ".jph", "--base lossless"],
                            "encode", self.root / "lamp.hdr", "-o", self.root / "bad.pnr", "--error", 1)
        for kind, word in ((".jph", "truncated"), (".pnr", "damaged")):
            whole, cut = self.root / ("whole" + kind), self.root / ("cut" + kind)
            self.run_json("encode", sun, "-o", whole)
            cut.write_bytes(whole.read_bytes()[:-40])
            self.expect_refusal(["cut" + kind, word], "decode", cut, "-o", self.root / "bad.exr")
        self.assertEqual(list(self.root.glob("bad*")), [])


class Tonemap(CliTest):
    OPERATORS = ("level-set", "photographic", "photographic-local", "bilateral", "filmic")

    @classmethod
    def make_files(cls):
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))
        files.write_sun_hdr(cls.root / "sun.hdr", 64, 32, 20000)
        (cls.root / "cut.hdr").write_bytes((cls.root / "even.hdr").read_bytes()[:3000])
        # A header that promises a hundred megapixels, over four bytes of them.
        (cls.root / "huge.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 10000 +X 10000\n"
                                            b"\x02\x02\x27\x10")
        files.write_png(cls.root / "a.png", 9, 7, lambda x, y: (x, y, 200))
        files.write_png(cls.root / "b.png", 9, 7, lambda x, y: (x, 40 * y, 100))

    def show(self, name, *options):
        out = self.root / "shown.png"
        told = self.run_json("tonemap", self.root / name, "-o", out, *options)
        width, height, pixels = files.read_png(out)
        self.assertEqual((told["width"], told["height"], width, height), (64, 32, 64, 32))
        return told, pixels

    def test_every_operator_shows_a_picture(self):
        for operator in self.OPERATORS:
            told, pixels = self.show("even.hdr", "--operator", operator)
            self.assertEqual(told["operator"], operator)
            self.assertEqual(len(set(pixels[0::3])), 1, operator)
            self.assertTrue(40 < pixels[2] < pixels[1] < pixels[0] < 230, (operator, pixels[:3]))
            self.assert_close(told["detail_rms"], 0, 1e-6)
            # One pixel of sun neither darkens the rest to black nor leaves its own place.
            _, pixels = self.show("sun.hdr", "--operator", operator)
            at = 3 * (8 * 64 + 40)
            self.assertGreater(pixels[at], pixels[0], operator)
            self.assertGreater(pixels[0], 40, operator)

    def test_exposure_brightens_and_detail_is_written(self):
        dark, bright = (self.show("even.hdr", "--exposure", stops)[1][0] for stops in (-2, 2))
        self.assertGreater(bright, dark + 60)
        detail = self.root / "detail.png"
        self.show("sun.hdr", "--operator", "bilateral", "--detail", detail)
        self.assertEqual(files.read_png(detail)[:2], (64, 32))

    def test_a_flag_of_another_operator_is_refused(self):
        for operator, flag, value in (("filmic", "--steps", 4), ("bilateral", "--contrast", 2),
                                      ("filmic", "--saturation", 0), ("level-set", "--white", 4)):
            self.expect_refusal([flag, operator], "tonemap", self.root / "even.hdr", "-o", self.root / "no.png",
                                "--operator", operator, flag, value)

    def test_compare_counts_what_is_black_in_one_and_takes_codes_for_what_they_show(self):
        files.write_lamp_hdr(self.root / "dark.hdr", 64, 32, (1, 1, 1))
        found = self.run_json("compare", self.root / "dark.hdr", self.root / "even.hdr")
        self.assertEqual((found["black_in_one"], found["compared_pixels"]), (64 * 32 - 1, 64 * 32))
        files.write_png(self.root / "codes.png", 64, 32, lambda x, y: (255, 188, 137))  # sRGB of 1, .5, .25
        found = self.run_json("compare", self.root / "codes.png", self.root / "even.hdr")
        self.assertLess(found["rel_rmse"], .01)
        self.assertLess(found["log10_rmse"], .005)

    def test_compare_says_why_a_figure_is_missing(self):
        for name, colour in (("black.hdr", (0, 0, 0)), ("grey.hdr", (.5, .5, .5))):
            files.write_hdr(self.root / name, 64, 32, colour)
        black, grey = self.root / "black.hdr", self.root / "grey.hdr"
        for pair, missing in (((grey, black), ("relative RMSE and no PSNR: .*black.hdr", "log10", "Sarnoff", "FLIP")),
                              ((black, black), ("log10", "Sarnoff", "FLIP")),
                              ((black, grey), ("log10", "PSNR of luminance: .*grey.hdr has one"))):
            done = self.run_program("compare", *pair)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertNotRegex(done.stdout, r"\bnan\b|-inf")
            for what in missing:
                self.assertRegex(done.stdout, rf"(?m)^no {what}")
        self.assertIsNone(self.run_json("compare", grey, black)["rel_rmse"])

    def test_a_gain_map_that_loses_light_says_so(self):
        files.write_lamp_hdr(self.root / "lamp.hdr", 256, 128, (1000, 300, 10))
        done = self.run_program("tonemap", self.root / "lamp.hdr", "-o", self.root / "lamp.jpg", "--gain-map")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertRegex(done.stderr, r"warning: .*lamp.jpg: the light of a channel comes back off by \d+ %")
        done = self.run_program("tonemap", self.root / "sun.hdr", "-o", self.root / "sun.jpg", "--gain-map")
        self.assertNotIn("warning", done.stderr)

    def test_a_gain_map_lights_as_the_picture_that_it_was_made_of(self):
        lit = self.root / "sun.jpg"
        self.run_json("tonemap", self.root / "sun.hdr", "-o", lit, "--gain-map")
        light = [self.run_json("light", "estimate", self.root / name) for name in ("sun.hdr", "sun.jpg")]
        for truth, got in zip(light[0]["mean_radiance"], light[1]["mean_radiance"]):
            self.assert_close(got, truth, 0.03 * truth)
        told = self.run_json("inspect", lit)
        self.assertEqual(told["kind"], "HDR picture")
        self.assert_close(told["largest_luminance"] / 20000, 1, 0.03)
        plain = self.root / "plain.jpg"
        self.run_json("tonemap", self.root / "sun.hdr", "-o", plain)
        self.expect_refusal(["plain.jpg", "without a gain map"], "light", "estimate", plain)
        self.expect_refusal(["--gain-map", "JPEG"], "tonemap", self.root / "sun.hdr", "-o", self.root / "sun.png",
                            "--gain-map")

    def test_pictures_that_flicker_follow_each_other_calmly(self):
        # A card in one corner that no lamp changes, and a wall that does, by a factor of two each time.
        folder = self.root / "flicker"
        folder.mkdir()
        for k in range(8):
            files.write_card_hdr(folder / f"p{k}.hdr", 64, 32, 0.25, 1.0 if k % 2 else 2.0)
        (folder / "preview.jpg").write_bytes(b"no picture at all")
        (folder / ".hidden.hdr").write_bytes(b"neither")

        def swing_of_card(*options):
            out = self.root / "calm"
            told = self.run_json("tonemap", folder, "-o", out, "--operator", "photographic", *options)
            self.assertEqual(told["pictures"], 8)
            codes = [files.read_png(out / f"p{k}.png")[2][0] for k in range(8)]
            return max(codes[2:]) - min(codes[2:])
        alone, together = swing_of_card("--adaptation", "0"), swing_of_card()
        self.assertGreater(alone, 20)
        self.assertLess(together, alone / 5)
        video = self.root / "calm.mp4"
        self.run_json("tonemap", folder, self.root / "even.hdr", "-o", video, "--fps", "24")
        self.assertGreater(video.stat().st_size, 500)

    def test_pictures_that_do_not_go_together_are_named(self):
        files.write_hdr(self.root / "small.hdr", 16, 8, (1.0, 0.5, 0.25))
        even, video = self.root / "even.hdr", self.root / "odd.mp4"
        self.expect_refusal(["small.hdr", "16x8", "64x32"], "tonemap", even, self.root / "small.hdr", "-o", video)
        self.assertFalse(video.exists())
        self.expect_refusal(["even.hdr", "name"], "tonemap", even, even, "-o", self.root / "twice")
        self.expect_refusal(["--gain-map", "single"], "tonemap", even, even, "-o", video, "--gain-map")
        self.expect_refusal(["shown.png", "folder"], "tonemap", even, even, "-o", self.root / "shown.png")
        (self.root / "none").mkdir()
        self.expect_refusal(["none", "no HDR pictures"], "tonemap", self.root / "none", "-o", video)

    def test_bad_input_is_one_line(self):
        out = self.root / "out" / "shown.png"
        for name in ("nowhere.hdr", "cut.hdr", "huge.hdr", "a.png"):
            self.expect_refusal([name], "tonemap", self.root / name, "-o", out)
        even = self.root / "even.hdr"
        self.expect_refusal(["--operator", "levelset", "level-set"], "tonemap", even, "-o", out, "--operator", "levelset")
        self.expect_refusal(["--detail", "filmic"], "tonemap", even, "-o", out, "--operator", "filmic",
                            "--detail", self.root / "out" / "detail.png")
        for flag, value in (("--exposure", 99), ("--key", 0), ("--steps", -1), ("--saturation", 3)):
            self.expect_refusal([flag], "tonemap", even, "-o", out, flag, value)
        self.expect_refusal(["shown.xyz"], "tonemap", even, "-o", self.root / "out" / "shown.xyz")

    def test_compare_draws_the_error(self):
        drawn = self.root / "error.png"
        for of in ("flip", "pu21", "sarnoff"):
            self.run_well("compare", self.root / "a.png", self.root / "a.png", "--map", drawn, "--map-of", of)
            self.assertEqual(set(files.read_png(drawn)[2]), {0}, of)
            told = self.run_json("compare", self.root / "a.png", self.root / "b.png", "--map", drawn, "--map-of", of)
            self.assertGreater(max(files.read_png(drawn)[2]), 0, of)
        self.assertGreater(told["mse"], 0)
        self.assertGreater(told["sarnoff"], 0)
        self.assertTrue(0 < told["pu21_psnr_db"] < 40 and told["pu21_ssim"] < 0.95, told)
        self.expect_refusal(["--map-of"], "compare", self.root / "a.png", self.root / "b.png", "--map-of", "eye")
        self.expect_refusal(["error.xyz"], "compare", self.root / "a.png", self.root / "b.png", "--map",
                            self.root / "out" / "error.xyz")


class Window(CliTest):
    """A real window, under Xvfb."""

    def test_live_demo_opens_a_window_and_ends(self):
        xvfb = shutil.which("xvfb-run")
        if not xvfb:
            self.skipTest("xvfb-run is not installed")
        done = subprocess.run([xvfb, "-a", program(), "demo", "--live", "--asset", "builtin:box", "--no-turntable", "--frames",
                               "12", "--width", "320", "--height", "180", "--out", str(self.root / "out")],
                              env=self.environment, capture_output=True, text=True, timeout=300 * PATIENCE, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("without a window", done.stderr)
        self.assertTrue((self.root / "out" / "still.png").is_file())


class Serve(CliTest):
    @classmethod
    def make_files(cls):
        files.write_scene(cls.root)
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))
        (cls.root / "rig.toml").write_text(
            'version = 1\n[capture]\nsource = "studio"\nenvironment = "even.hdr"\nwidth = 128\nheight = 96\n'
            '[scene]\nfile = "scene.toml"\n[light]\nbands = 2\nstale_after_s = 5\n[http]\nport = 0\n')

    def setUp(self):
        self.make_files()  # a test may have written into them
        self.addCleanup(self.finish)
        self.start("rig.toml")

    def start(self, rig, **variables):
        self.lines = []
        self.process = subprocess.Popen([program(), "serve", "--config", str(self.root / rig)],
                                        env=self.environment | variables, stdout=subprocess.PIPE,
                                        stderr=subprocess.PIPE, text=True)
        listening = threading.Event()

        def read():
            for line in self.process.stderr:
                self.lines.append(line)
                if "listening on" in line:
                    listening.set()
            listening.set()

        self.reader = threading.Thread(target=read)
        self.reader.start()
        listening.wait(120)
        said = "".join(self.lines)
        found = re.search(r"listening on http://127\.0\.0\.1:(\d+)", said)
        if not found and re.search(r"EGL|OpenGL ES", said):
            self.skipTest("no OpenGL ES 3.1: " + said.strip())
        self.assertTrue(found, said)
        self.base = f"http://127.0.0.1:{found.group(1)}"

    def finish(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.reader.join()
        self.process.stdout.close()
        self.process.stderr.close()

    def get(self, path, method="GET"):
        """(status, kind, body)"""
        request = urllib.request.Request(self.base + path, method=method)
        try:
            with urllib.request.urlopen(request, timeout=20 * PATIENCE) as reply:
                return reply.status, reply.headers.get("Content-Type", ""), reply.read()
        except urllib.error.HTTPError as e:
            with e:
                return e.code, e.headers.get("Content-Type", ""), e.read()

    def wait_until_ok(self):
        for _ in range(300):
            status, _, body = self.get("/healthz")
            health = json.loads(body)
            if health["status"] in ("ok", "slow"):  # a busy machine is slow
                self.assertEqual(status, 200)
                return health
            self.assertEqual(status, 503)
            time.sleep(0.1)
        self.fail(f"never ok: {health}\n{''.join(self.lines)}")

    def test_the_studio_is_seen_in_a_headset(self):
        """Its frames are of now, so that the runtime knows where the head was at their times."""
        runtime = os.environ.get("PENUMBRA_FAKE_OPENXR_RUNTIME")
        if not runtime:
            self.skipTest("PENUMBRA_FAKE_OPENXR_RUNTIME does not name the runtime of the tests")
        self.finish()
        rig = (self.root / "rig.toml").read_text()
        (self.root / "headset.toml").write_text(rig + "[output]\nopenxr = true\n")
        (self.root / "runtime.json").write_text(json.dumps(
            {"file_format_version": "1.0.0", "runtime": {"library_path": runtime}}))
        self.start("headset.toml", XR_RUNTIME_JSON=str(self.root / "runtime.json"))
        self.wait_until_ok()
        until = time.monotonic() + 30 * PATIENCE
        while time.monotonic() < until:
            headset = json.loads(self.get("/healthz")[2]).get("headset", {})
            if headset.get("shown", 0) >= 30:
                break
            time.sleep(.1)
        self.assertGreaterEqual(headset["shown"], 30, headset)
        self.assertEqual(headset["unplaced"], 0, headset)
        self.assertEqual(headset["phase"], "running")
        age_ms = headset["latency"]["capture_to_display"]["p50_ms"]
        self.assertTrue(0 < age_ms < 1000 * PATIENCE, headset)

    def objects(self):
        return {o["name"]: o for o in json.loads(self.get("/v1/objects")[2])["objects"]}

    def wait_for(self, what, true):
        for _ in range(1200):
            if true():
                return
            self.assertIsNone(self.process.poll(), "".join(self.lines))
            time.sleep(.1)
        self.fail(f"{what}: {self.objects()}\n{''.join(self.lines)}")

    def check_objects(self):
        """Moved by a request, and by the scene file on SIGHUP, which also brings and takes objects; SIGUSR1
        changes nothing."""
        self.wait_for("no object is baked", self.objects)
        name, before = next(iter(self.objects().items()))
        body = json.dumps({"position_m": [0.1, 0, 0.2], "turn_deg": 45}).encode()
        request = urllib.request.Request(f"{self.base}/v1/objects/{name}", data=body, method="PATCH",
                                         headers={"Content-Type": "application/json"})
        with urllib.request.urlopen(request, timeout=20 * PATIENCE) as reply:
            self.assertEqual(reply.status, 200)
        self.assertEqual(self.objects()[name]["position_m"], [0.1, 0, 0.2])
        self.process.send_signal(signal.SIGUSR1)
        scene = self.root / "scene.toml"
        text = scene.read_text()
        at = text.index("\n", text.index("[[object]]")) + 1
        scene.write_text(text[:at] + "position = [0.3, 0, 0]\n" + text[at:])
        self.process.send_signal(signal.SIGHUP)
        moved = before["position_m"][0] + .3
        self.wait_for("not moved", lambda: abs(self.objects()[name]["position_m"][0] - moved) < 1e-6)
        scene.write_text(scene.read_text() + '[[object]]\nname = "crate"\nasset = "builtin:box"\n'
                         'fit_size_m = 0.2\nposition = [-0.3, 0, 0]\n')
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("no crate", lambda: "crate" in self.objects())
        self.assertLess(abs(self.objects()[name]["position_m"][0] - moved), 1e-6)
        scene.write_text(text)
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("the crate stays", lambda: "crate" not in self.objects())
        scene.write_text("version = 77\n")
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("not refused", lambda: any("the scene stays as it is" in line for line in self.lines))

    def check_rig(self):
        """The limit of the errors and the outputs follow rig.toml on SIGHUP; the rest waits and is named."""
        rig, picture = self.root / "rig.toml", self.root / "picture.y4m"
        text = rig.read_text()
        state = lambda: json.loads(self.get("/v1/state")[2])
        limit = lambda: state()["budget"]["max_shadow_error"]
        self.assertEqual(limit(), .05)
        changed = text.replace("bands = 2", "bands = 3\nmax_shadow_error = 0.11")
        rig.write_text(changed + '[output]\ny4m = "picture.y4m"\n')
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("another limit", lambda: limit() == .11)
        self.wait_for("no picture", lambda: picture.exists() and picture.stat().st_size > 3 * 128 * 96)
        self.wait_for("the rest is not named", lambda: any("light.bands of" in line and "next start" in line
                                                           for line in self.lines))
        self.assertEqual(len(state()["outputs"]), 1)
        rig.write_text(changed + '[output]\ny4m = "nowhere/picture.y4m"\n')
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("no error", lambda: any("output.y4m stays as it is" in line for line in self.lines))
        self.assertEqual(len(state()["outputs"]), 1)
        rig.write_text(changed)
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("the output stays", lambda: not state()["outputs"])
        rig.write_text("version = 1\n[capture\n")
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("not refused", lambda: any("the rig stays as it is" in line for line in self.lines))
        rig.write_text(text)
        self.process.send_signal(signal.SIGHUP)
        self.wait_for("not as at first", lambda: limit() == .05)

    def test_service_answers_and_ends_when_told(self):
        self.assertGreater(self.wait_until_ok()["frames"], 0)
        status, kind, body = self.get("/v1/light")
        self.assertEqual((status, kind), (200, "application/json"))
        light = json.loads(body)
        self.assertLessEqual({"bands", "coefficients", "lights", "mean_radiance", "coverage", "clipped_fraction",
                              "truncation_error", "uncertainty", "time_ns", "age_s", "valid"}, set(light))
        self.assertEqual((light["bands"], len(light["coefficients"]), light["valid"]), (2, 4, True))
        red, green, blue = light["coefficients"][0]
        self.assert_close(green / red, 0.5, 0.02)
        self.assert_close(blue / red, 0.25, 0.02)
        status, kind, body = self.get("/v1/frame.jpg")
        self.assertEqual((status, kind, body[:3]), (200, "image/jpeg", b"\xff\xd8\xff"))
        for path in ("/v1/nothing", "/index.html", "/v1/light/..%2f..%2fetc", "/" + "x" * 3000):
            status, kind, body = self.get(path)
            self.assertEqual((status, kind), (404, "application/json"), path)
            self.assertIn("error", json.loads(body))
        self.assertGreaterEqual(self.get("/healthz", "DELETE")[0], 400)
        self.check_rig()
        self.check_objects()
        self.process.send_signal(signal.SIGTERM)
        self.assertEqual(self.process.wait(timeout=60 * PATIENCE), 0, "".join(self.lines))


class Record(CliTest):
    def rig(self, text):
        path = self.root / "rig.toml"
        path.write_text("version = 1\n" + text)
        return path

    def studio(self):
        return self.rig('[capture]\nsource = "studio"\nwidth = 320\nheight = 180\nfps = 60\n')

    def cameras_of(self, recording):
        return {c["name"]: c for c in self.run_json("inspect", recording)["cameras"]}

    def test_recording_of_a_capture_replays_to_the_same_bytes(self):
        folder = self.root / "folder"
        self.run_well("demo", "--headless", "--frames", 12, "--width", 320, "--height", 180, "--out",
                      self.root / "demo", "--asset", "builtin:box", "--no-turntable", "--record", folder)
        frames = sum(len((folder / f"{name}.csv").read_text().splitlines()) - 1 for name in ("environment", "view"))
        rig = self.rig(f'[capture]\nsource = "{folder}"\n[scene]\nfile = "{folder}/scene.toml"\n')
        recording = self.root / "a.mkv"
        printed = self.run_json("record", "--config", rig, "--out", recording, "--frames", frames)
        self.assertEqual(printed["bytes"] >= recording.stat().st_size, True)
        self.assertEqual(sum(c["frames"] for c in printed["cameras"]), frames)
        self.assertEqual(self.cameras_of(recording)["view"]["frames"], 12)
        for name, capture in (("first", folder), ("second", recording), ("third", recording)):
            self.run_well("composite", "--capture", capture, "--scene", folder / "scene.toml", "--coarse",
                          "--out", self.root / name)
        for i in range(12):
            pictures = {(self.root / run / f"frame_{i:06}.png").read_bytes() for run in ("first", "second", "third")}
            self.assertEqual(len(pictures), 1, f"frame {i}")

    def test_light_of_a_track_makes_the_pictures_that_its_cameras_make(self):
        folder, takes = self.root / "film", {}
        self.run_well("demo", "--headless", "--frames", 12, "--width", 320, "--height", 180, "--out",
                      self.root / "filmed", "--asset", "builtin:box", "--no-turntable", "--record", folder)
        frames = sum(len((folder / f"{name}.csv").read_text().splitlines()) - 1 for name in ("environment", "view"))
        rig = self.rig(f'[capture]\nsource = "{folder}"\n[scene]\nfile = "{folder}/scene.toml"\n')
        for light in ("cameras", "track", "both"):
            takes[light] = self.root / f"light_{light}.mkv"
            self.run_json("record", "--config", rig, "--out", takes[light], "--light", light, "--seconds", .6)
        names = {light: set(self.cameras_of(take)) for light, take in takes.items()}
        self.assertEqual(names, {"cameras": {"environment", "view"}, "track": {"view", "light"},
                                 "both": {"environment", "view", "light"}})
        maps = self.cameras_of(takes["track"])["light"]
        self.assertGreater(maps["frames"], (frames - 12) // 2)
        of_cameras = takes["cameras"].stat().st_size - takes["track"].stat().st_size
        self.assertGreater(of_cameras, 50 * 2000 * maps["frames"])
        runs = {"cameras": ("both", "cameras"), "track": ("both", "track"), "alone": ("track", "auto")}
        exposures = {}
        for run, (take, light) in runs.items():
            summary = self.run_json("composite", "--capture", takes[take], "--scene", folder / "scene.toml",
                                    "--coarse", "--light", light, "--out", self.root / run)
            exposures[run] = summary["configuration"]["exposures"]
        self.assertGreater(exposures["cameras"], 1)
        self.assertEqual((exposures["track"], exposures["alone"]), (0, 0))
        for i in (6, 11):
            name = f"frame_{i:06}.png"
            self.assertEqual((self.root / "track" / name).read_bytes(), (self.root / "alone" / name).read_bytes())
            apart = self.run_json("compare", self.root / "cameras" / name, self.root / "track" / name)
            self.assertLess(apart["rel_rmse"], .02, apart)
            plain = self.run_json("compare", self.root / "cameras" / name, folder / "view" / name[6:])
            self.assertGreater(plain["rel_rmse"], 4 * apart["rel_rmse"], "nothing was put in")
        # A part alone: pictures 8 to 10 of the whole.
        summary = self.run_json("composite", "--capture", takes["track"], "--scene", folder / "scene.toml",
                                "--coarse", "--from", 7.6 / 30, "--seconds", .09, "--out", self.root / "part")
        self.assertEqual(summary["frames"], 3)
        part = sorted(p.name for p in (self.root / "part").glob("frame_*.png"))
        self.assertEqual(part, [f"frame_{i:06}.png" for i in range(3)])
        whole = [self.run_json("compare", self.root / "part" / part[0], self.root / "alone" / f"frame_{i:06}.png")
                 ["rel_rmse"] for i in range(12)]
        self.assertEqual(min(range(12), key=whole.__getitem__), 8, whole)
        for capture in (takes["track"], folder):
            self.expect_refusal(["--from", "behind the last picture"], "composite", "--capture", capture, "--scene",
                                folder / "scene.toml", "--coarse", "--from", 1000, "--out", self.root / "none")
        environment = self.run_json("hdr", "environment", takes["track"], "-o", self.root / "of_track.exr")
        self.assertEqual(environment["width"], maps["width"])
        self.expect_refusal(["light_cameras.mkv", "no light track"], "composite", "--capture", takes["cameras"],
                            "--scene", folder / "scene.toml", "--light", "track", "--out", self.root / "none")
        self.expect_refusal(["capture folder"], "composite", "--capture", folder, "--scene",
                            folder / "scene.toml", "--light", "track", "--out", self.root / "none")
        self.expect_refusal(["sun", "auto, cameras and track"], "composite", "--capture", folder, "--scene",
                            folder / "scene.toml", "--light", "sun", "--out", self.root / "none")
        self.expect_refusal(["16..1024"], "record", "--config", rig, "--out", self.root / "no.mkv", "--light",
                            "track", "--light-rows", 3)

    def test_stopped_recording_is_whole(self):
        recording = self.root / "stopped.mkv"
        process = subprocess.Popen([program(), "record", "--config", self.studio(), "--out", recording],
                                   stdout=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 60 * PATIENCE
        while not (recording.exists() and recording.stat().st_size > 1_000_000):
            self.assertLess(time.monotonic(), deadline)
            time.sleep(.05)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60 * PATIENCE)
        self.assertEqual(process.returncode, 0)
        cameras = self.cameras_of(recording)
        for name in ("environment", "view"):
            self.assertIn(f"{name} {cameras[name]['frames']} frames", said)
            self.assertGreater(cameras[name]["frames"], 0)

    def test_what_stands_there_is_kept(self):
        recording = self.root / "there.mkv"
        recording.write_text("earlier")
        self.expect_refusal(["there.mkv", "exists already"], "record", "--config", self.studio(), "--out", recording)
        self.assertEqual(recording.read_text(), "earlier")
        self.expect_refusal(["there.mkv", "not a Matroska file"], "inspect", recording)
        self.expect_refusal(["no/such"], "record", "--config", self.studio(), "--out", self.root / "no/such/a.mkv")
        self.expect_refusal(["--seconds"], "record", "--config", self.studio(), "--out", self.root / "b.mkv",
                            "--seconds", -1)


class Calibrate(CliTest):
    def boards(self):
        return sorted(self.shared_folder("eval-only/calibration/fisheye_gopro").glob("*.JPG"))[12:18]

    def test_camera_file_is_one_that_the_others_read(self):
        out, report = self.root / "fisheye.toml", self.root / "report"
        printed = self.run_json("calibrate", "camera", *self.boards(), "--board", "chessboard:15x9:0.026",
                                "--projection", "kb4", "-o", out, "--report", report)
        self.assertLess(printed["rms_px"], .35)
        damaged = self.root / "damaged.jpg"
        damaged.write_bytes(self.boards()[0].read_bytes()[:50])
        without = self.run_json("calibrate", "camera", *self.boards(), damaged, "--board", "chessboard:15x9:0.026",
                                "--projection", "kb4", "-o", self.root / "again.toml")
        self.assertEqual((without["unreadable"], without["rms_px"]), ([str(damaged)], printed["rms_px"]))
        self.assertAlmostEqual(printed["focal_px"][0], 436.9, delta=8)  # six boards
        self.assertEqual(sorted(p.name for p in report.iterdir()),
                         ["boards.svg", "coverage.svg", "residuals.csv", "residuals.svg"])
        self.assertEqual(self.run_json("inspect", out)["projection"], "kb4")
        rig = self.root / "rig.toml"
        rig.write_text('version = 1\n[capture]\nsource = "cameras"\n[scene]\nfile = "s.toml"\n[[camera]]\n'
                       'name = "env"\nrole = "environment"\ndevice = "/dev/none"\nresponse = "srgb"\n'
                       'intrinsics = "fisheye.toml"\n[[camera]]\nname = "view"\nrole = "view"\ndevice = "/dev/nothing"\n'
                       'response = "srgb"\nprojection = "pinhole"\nwidth = 64\nheight = 48\n')
        self.assertEqual(self.run_json("inspect", rig)["kind"], "rig")
        rig.write_text(rig.read_text().replace('role = "environment"\n', 'role = "environment"\nwidth = 640\n'))
        self.expect_refusal(["rig.toml", "width", "1000"], "inspect", rig)

    def test_a_rig_is_looked_at_for_so_many_seconds(self):
        folder, out = self.root / "boards", self.root / "live.toml"
        folder.mkdir()
        rows = ["file,time_s,exposure_s,gain"]
        for n, board in enumerate(self.boards()):
            shutil.copy(board, folder / f"{n}.jpg")
            rows.append(f"{n}.jpg,{n},0.01,1")
        (folder / "c.csv").write_text("\n".join(rows) + "\n")
        width, height = 1000, 750
        (folder / "capture.toml").write_text(
            f'version = 1\n[[camera]]\nname = "c"\nrole = "view"\nwidth = {width}\nheight = {height}\n'
            'projection = "pinhole"\nresponse = "srgb"\nframes = "c.csv"\n')
        rig = self.root / "rig-live.toml"
        rig.write_text(f'version = 1\n[capture]\nsource = "{folder}"\n')
        printed = self.run_json("calibrate", "camera", "--capture", rig, "--camera", "c", "--seconds", "5.5", "--board",
                                "chessboard:15x9:0.026", "--projection", "kb4", "-o", out)
        self.assertLess(printed["rms_px"], .4)
        self.assertGreaterEqual(len(printed["boards"]), 4)
        self.expect_refusal(["no camera"], "calibrate", "camera", "--capture", rig, "--camera", "d", "--board",
                            "chessboard:15x9:0.026", "-o", out)

    def test_calibrations_of_others_become_files_that_are_read(self):
        seeds = pathlib.Path(__file__).resolve().parents[1] / "fuzz/corpus/import"
        lens, pose = self.root / "left.toml", self.root / "pose.toml"
        printed = self.run_json("calibrate", "import", seeds / "index.json", "--camera", "left", "-o", lens,
                                "--pose", pose)
        self.assertEqual((printed["format"], printed["body"]), ("Valve Index config", "head"))
        read = self.run_json("inspect", lens)
        for key in ("name", "projection", "width", "height"):
            self.assertEqual(read[key], printed[key])
        self.run_well("inspect", pose)
        again = self.root / "out" / "again.toml"
        self.expect_refusal(["index.json", "left, right"], "calibrate", "import", seeds / "index.json", "-o", again)
        self.expect_refusal(["ros.yaml", "where its cameras are"], "calibrate", "import", seeds / "ros.yaml", "-o",
                            again, "--pose", self.root / "out" / "none.toml")

    def test_response_of_a_bracket_is_one_that_the_merge_reads(self):
        times = [1 / 64, 1 / 16, 1 / 4]
        pictures = []
        for k, t in enumerate(times):
            pictures.append(self.root / f"b{k}.png")

            def codes(x, y, t=t):
                light = .02 * 1000 ** (x / 95) * (1 + y / 48)
                return [round(255 * min(1, light * t * g) ** (1 / 2.2)) for g in (.9, 1, 1.1)]
            files.write_png(pictures[-1], 96, 48, codes)
        out, report = self.root / "response.toml", self.root / "curve"
        given = ["--times", ",".join(str(t) for t in times)]
        printed = self.run_json("calibrate", "response", *pictures, *given, "-o", out, "--report", report)
        self.assertLess(printed["sigma"], .005)
        self.assertEqual(sorted(p.name for p in report.iterdir()), ["response.csv", "response.svg"])
        rows = [line.split(",") for line in (report / "response.csv").read_text().splitlines()[1:]]
        top = float(rows[240][2])
        for code in (40, 90, 180):
            self.assertAlmostEqual(float(rows[code][2]) / top, (code / 240) ** 2.2, delta=.01)
        self.assertEqual(self.run_json("inspect", out)["kind"], "response")
        self.run_well("hdr", "merge", *pictures, *given, "--response", out, "-o", self.root / "m.exr")
        self.assertNotIn("a time is wrong", self.run_program("calibrate", "response", *pictures, *given, "-o", out).stderr)
        wrong = ["--times", ",".join(str(t * (1.8 if k == 1 else 1)) for k, t in enumerate(times))]
        self.assertIn("a time is wrong", self.run_program("calibrate", "response", *pictures, *wrong, "-o", out).stderr)
        self.expect_refusal(["equal"], "calibrate", "response", *pictures, "--times", "1,1,1", "-o",
                            self.root / "no.toml")
        self.assertFalse((self.root / "no.toml").exists())
        self.assertIn("would go unnoticed", self.run_program("calibrate", "response", *pictures[:2], "--times",
                                                             "1/64,1/16", "-o", out).stderr)

    def test_the_one_wrong_time_of_a_bracket_is_named(self):
        times = [4 ** k / 256 for k in range(5)]
        pictures = []
        for k, t in enumerate(times):
            pictures.append(self.root / f"w{k}.png")

            def codes(x, y, t=t):
                light = .02 * 3000 ** (x / 95) * (1 + y / 48)
                return [round(255 * min(1, light * t * g) ** (1 / 2.2)) for g in (.9, 1, 1.1)]
            files.write_png(pictures[-1], 96, 48, codes)
        for k in range(1, 4):  # outermost ones bend the curve instead
            for factor in (1.8, 1 / 1.8):
                told = ",".join(str(t * (factor if n == k else 1)) for n, t in enumerate(times))
                said = self.run_program("calibrate", "response", *pictures, "--times", told, "-o",
                                        self.root / "w.toml").stderr
                self.assertIn(f"w{k}.png: its time of {times[k] * factor:.4g} s is wrong", said)
                shown = float(said.split("and tell ")[1].split(" s for it")[0])
                self.assertAlmostEqual(shown / times[k], 1, delta=.03)
                self.assertEqual(len(said.splitlines()), 1, said)

    def test_response_of_two_clips_is_one_that_the_merge_reads(self):
        draw = random.Random(3)
        clips = []
        for k, t in enumerate((1 / 64, 1 / 16)):
            folder = self.root / f"clip{k}"
            folder.mkdir()
            (folder / "capture.toml").write_text(
                'version = 1\n[[camera]]\nname = "c"\nrole = "view"\nwidth = 96\nheight = 48\n'
                'projection = "pinhole"\nresponse = "srgb"\nframes = "c.csv"\n')
            rows = ["file,time_s,exposure_s,gain"]
            for n in range(4):
                def codes(x, y, t=t):
                    light = .02 * 1500 ** (x / 95) * (1 + y / 48)
                    return [round(255 * min(1, max(0, light * t * g + draw.gauss(0, .004))) ** (1 / 2.2))
                            for g in (.9, 1, 1.1)]
                files.write_png(folder / f"{n}.png", 96, 48, codes)
                rows.append(f"{n}.png,{n / 30},{t},1")
            (folder / "c.csv").write_text("\n".join(rows) + "\n")
            clips.append(folder)
        out, report = self.root / "clips.toml", self.root / "clips"
        captures = ["--capture", clips[0], "--capture", clips[1], "--camera", "c"]
        printed = self.run_json("calibrate", "response", *captures, "-o", out, "--report", report)
        self.assertEqual(printed["pictures"], 2)
        rows = [line.split(",") for line in (report / "response.csv").read_text().splitlines()[1:]]
        top = float(rows[230][2])
        for code in (60, 90, 180):
            self.assertAlmostEqual(float(rows[code][2]) / top, (code / 230) ** 2.2, delta=.02)
        no = ["-o", self.root / "no.toml"]
        self.expect_refusal(["1 exposure"], "calibrate", "response", *captures[:2], "--camera", "c", *no)
        self.expect_refusal(["no camera"], "calibrate", "response", *captures[:4], "--camera", "d", *no)
        self.expect_refusal(["needs images"], "calibrate", "response", *no)

    def test_place_of_a_ball_is_one_that_a_camera_reads(self):
        rig = self.root / "balls.toml"
        rig.write_text('version = 1\n' + "".join(
            f'[[camera]]\nname = "{name}"\nrole = "view"\ndevice = "/dev/{name}"\nresponse = "srgb"\n'
            f'projection = "pinhole"\nwidth = 1280\nheight = 720\nfocal_px = [1000, 1000]\n'
            f'world_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, {x},0,0,1]\n' for name, x in (("a", 0), ("b", 0.5))))
        # 2 m ahead, halfway between the two: 125 px to the right of one's middle and to the left of the other's.
        one = self.run_json("calibrate", "ball", rig, "--outline", "a:765,360,25.2", "--radius", "0.05")
        self.assertAlmostEqual(one["centre_m"][2], -2, delta=.05)
        two = self.run_json("calibrate", "ball", rig, "--outline", "a:765,360,25.2", "--outline", "b:515,360,25.2",
                            "--radius", "0.05")
        self.assertAlmostEqual(two["centre_m"][0], .25, delta=.003)
        self.assertLess(max(two["sigma_m"]), .02)
        for words, outline in ((["no camera"], "c:1,2,3"), (["NAME:x,y,radius"], "a:1,2"),
                               (["NAME:x,y,radius"], "a:1,2,3,4"), (["partly outside"], "a:1,2,30")):
            self.expect_refusal(words, "calibrate", "ball", rig, "--outline", outline, "--radius", "0.05")
        self.expect_refusal(["sees the ball"], "calibrate", "ball", rig, "--outline", "a:765,360,25.2", "--outline",
                            "b:700,360,25.2", "--radius", "0.05")

    def test_vignetting_of_even_paper_is_one_that_a_capture_reads(self):
        pictures = []
        for k, slope in enumerate((.1, -.1)):
            pictures.append(self.root / f"paper{k}.png")

            def codes(x, y, slope=slope):
                dx, dy = (x - 79.5) / 100, (y - 59.5) / 100
                light = .5 * (1 + slope * dx) * (1 - .4 * (dx * dx + dy * dy))
                return [round(255 * light ** (1 / 2.2))] * 3
            files.write_png(pictures[-1], 160, 120, codes)
        out, report = self.root / "vignetting.toml", self.root / "vignetting"
        printed = self.run_json("calibrate", "vignetting", *pictures, "--response", "gamma:2.2", "-o", out,
                                "--report", report)
        self.assertAlmostEqual(printed["corner"], .6, delta=.01)
        self.assertEqual(sorted(p.name for p in report.iterdir()), ["vignetting.csv", "vignetting.svg"])
        self.assertAlmostEqual(self.run_json("inspect", out)["corner"], printed["corner"], delta=1e-3)
        camera = self.root / "camera.toml"
        camera.write_text('version = 1\n[[camera]]\nname = "c"\nrole = "view"\nwidth = 160\nheight = 120\n'
                          'projection = "pinhole"\nvignetting = "vignetting.toml"\n')
        self.run_well("inspect", camera)
        camera.write_text(camera.read_text().replace("vignetting.toml", "nowhere.toml"))
        self.expect_refusal(["nowhere.toml"], "inspect", camera)
        files.write_png(pictures[0], 160, 120, lambda x, y: (1, 1, 1))
        self.expect_refusal(["paper0.png", "too dark"], "calibrate", "vignetting", *pictures, "-o",
                            self.root / "no.toml")
        self.assertFalse((self.root / "no.toml").exists())

    def test_noise_of_a_still_scene_is_one_file_that_a_capture_reads(self):
        folder, out, report = self.root / "still", self.root / "noise.toml", self.root / "noise"
        folder.mkdir()
        draw, full_well, read = random.Random(1), 2500, .004
        rows = ["file,time_s,exposure_s,gain"]
        for n in range(12):
            def codes(x, y):
                light = .9 * .002 ** (x / 63)
                noise = math.sqrt(light / full_well + read ** 2)
                return [round(255 * min(1, max(0, light * g + noise * draw.gauss(0, 1)))  ** (1 / 2.2))
                        for g in (1, 1, 1)]
            files.write_png(folder / f"f{n}.png", 64, 60, codes)
            rows.append(f"f{n}.png,{n},0.01,1")
        (folder / "camera.csv").write_text("\n".join(rows) + "\n")
        manifest = ('version = 1\n[[camera]]\nname = "camera"\nrole = "view"\nwidth = 64\nheight = 60\n'
                    'projection = "pinhole"\nresponse = "gamma:2.2"\nframes = "camera.csv"\n')
        (folder / "capture.toml").write_text(manifest)
        printed = self.run_json("calibrate", "noise", folder, "-o", out, "--report", report)
        self.assertAlmostEqual(printed["full_well_electrons"], full_well, delta=.1 * full_well)
        self.assertAlmostEqual(printed["read_noise"], read, delta=.25 * read)
        self.assertEqual(sorted(p.name for p in report.iterdir()), ["noise.csv", "noise.svg"])
        self.assertEqual(self.run_json("inspect", out)["kind"], "noise")
        self.assertEqual(self.run_json("inspect", report / "noise.svg")["kind"], "plot")
        table = self.run_json("inspect", report / "noise.csv")
        self.assertEqual((table["kind"], table["rows"]), ("table", printed["points"]))
        self.assertIn("signal", table["columns"])
        self.assertAlmostEqual(printed["neighbour_correlation"], 0, delta=.05)
        (folder / "noise.toml").write_text(out.read_text())
        (folder / "capture.toml").write_text(manifest + 'noise = "noise.toml"\n')
        self.run_json("inspect", folder)
        (folder / "capture.toml").write_text(manifest + 'noise = "noise.toml"\nread_noise = 0.1\n')
        self.expect_refusal(["capture.toml", "read_noise", "noise file"], "inspect", folder)
        (folder / "capture.toml").write_text(manifest)
        (folder / "camera.csv").write_text("\n".join(rows[:5]) + "\n")
        self.expect_refusal(["8 are needed"], "calibrate", "noise", folder, "-o", self.root / "no.toml")
        self.expect_refusal(["no camera", "side"], "calibrate", "noise", folder, "--camera", "side", "-o",
                            self.root / "no.toml")
        self.assertFalse((self.root / "no.toml").exists())

    MATRIX = ((1.6, -.2, .05), (-.1, 1.3, -.15), (0, -.3, 1.8))

    def two_cameras(self, folder, light):
        """A lat-long and a view camera of other colours in far surroundings, as a capture folder."""
        folder.mkdir()
        encode = lambda v: round(255 * min(1, max(0, v)) ** (1 / 2.2))

        def environment(x, y):
            east, theta = 2 * math.pi * (x + .5) / 192 - math.pi, math.pi * (y + .5) / 96
            return light(math.sin(theta) * math.sin(east), math.cos(theta), -math.sin(theta) * math.cos(east))

        def view(x, y):
            d = ((x + .5 - 64) / 60, (40 - y - .5) / 60, -1)
            n = math.sqrt(sum(v * v for v in d))
            seen = light(*(v / n for v in d))
            return [encode(sum(m * s for m, s in zip(row, seen))) for row in self.MATRIX]

        files.write_png(folder / "e.png", 192, 96, lambda x, y: [encode(v) for v in environment(x, y)])
        files.write_png(folder / "v.png", 128, 80, view)
        for c in "ev":
            (folder / f"{c}.csv").write_text(f"file,time_s,exposure_s,gain\n{c}.png,0,1,1\n")
        (folder / "capture.toml").write_text(
            'version = 1\n[[camera]]\nname = "environment"\nrole = "environment"\nwidth = 192\nheight = 96\n'
            'projection = "latlong"\nresponse = "gamma:2.2"\nframes = "e.csv"\n[[camera]]\nname = "view"\n'
            'role = "view"\nwidth = 128\nheight = 80\nprojection = "pinhole"\nfocal_px = [60, 60]\n'
            'response = "gamma:2.2"\nframes = "v.csv"\n')
        return folder

    def test_colours_of_two_cameras_are_one_that_a_capture_reads(self):
        def coloured(x, y, z):
            return [.3 + .2 * math.sin(a) for a in (7 * x + 3 * y, 6 * y - 5 * x + z, 4 * z + 8 * x * y)]

        capture, report, out = self.two_cameras(self.root / "two", coloured), self.root / "colours", self.root / "c.toml"
        printed = self.run_json("calibrate", "colour", capture, "-o", out, "--report", report)
        self.assertEqual(printed["surfaces"], printed["used"])
        for row, expected in zip(printed["matrix"], self.MATRIX):
            for value, truth in zip(row, expected):
                self.assertAlmostEqual(value, truth, delta=.03)
        self.assertEqual(sorted(p.name for p in report.iterdir()), ["colours.csv", "colours.svg"])
        manifest = (capture / "capture.toml").read_text()
        self.assertEqual(self.run_json("inspect", out)["kind"], "colour")
        (capture / "colour.toml").write_text(out.read_text())
        (capture / "capture.toml").write_text(manifest.replace('role = "environment"\n',
                                                               'role = "environment"\ncolour = "colour.toml"\n'))
        self.assertEqual(self.run_json("inspect", capture)["cameras"][0]["name"], "environment")
        (capture / "capture.toml").write_text(manifest.replace('role = "view"\n',
                                                               'role = "view"\ncolour = "colour.toml"\n'))
        self.expect_refusal(["capture.toml", "colour", "environment camera"], "inspect", capture)

    def test_colours_of_even_surroundings_are_refused(self):
        capture, out = self.two_cameras(self.root / "even", lambda x, y, z: (.3 + .02 * y, .3, .28)), self.root / "e.toml"
        self.expect_refusal(["colour", "chart"], "calibrate", "colour", capture, "-o", out)
        self.expect_refusal(["environment", "ColorChecker"], "calibrate", "colour", capture, "--chart", "-o", out)
        self.expect_refusal(["side", "not a camera"], "calibrate", "colour", capture, "--view", "side", "-o", out)
        self.expect_refusal(["tint", "matrix, gains and scale"], "calibrate", "colour", capture, "--model", "tint", "-o",
                            out)
        self.assertFalse(out.exists())

    @staticmethod
    def chessboard(width, height, focal, square, u, v, centre):
        """Pixels of a board of 7 x 5 inner corners in the camera's frame: axes, and where its middle is."""
        n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        reach = sum(a * b for a, b in zip(n, centre))

        def pixel(x, y):
            d = ((x + .5 - width / 2) / focal, (height / 2 - y - .5) / focal, -1)
            away = sum(a * b for a, b in zip(n, d))
            p = [reach / away * a - b for a, b in zip(d, centre)]
            a = sum(i * j for i, j in zip(p, u)) / square
            b = sum(i * j for i, j in zip(p, v)) / square
            if abs(a) > 4 or abs(b) > 3:
                return (235, 235, 235)
            # Eight by six squares with soft edges; the inner corners stand at whole numbers.
            light = math.sin(math.pi * a) * math.sin(math.pi * b)
            return (round(128 + 100 * max(-1, min(1, 4 * light))),) * 3
        return pixel

    def stereo(self, folder):
        """Two cameras 120 mm apart, the right one turned inwards by 6 degrees, and a chessboard that a hand moves."""
        folder.mkdir()
        width, height, focal, square = 320, 240, 330, .04
        inwards = math.radians(6)

        def render(camera, turn, tilt, at):
            # Board to camera; x right, y up, -z ahead.
            cy, sy, cx, sx = math.cos(turn), math.sin(turn), math.cos(tilt), math.sin(tilt)
            u, v = (cy, sx * sy, -cx * sy), (0, cx, sx)
            centre = at
            if camera == "right":
                c, s = math.cos(inwards), math.sin(inwards)
                into = lambda p: (c * p[0] - s * p[2], p[1], s * p[0] + c * p[2])
                u, v, centre = into(u), into(v), into((at[0] - .12, at[1], at[2]))
            return self.chessboard(width, height, focal, square, u, v, centre)

        for camera in ("left", "right"):
            rows = ["file,time_s,exposure_s,gain"]
            for n, (turn, tilt, x, y, z) in enumerate([(.1, .2, .06, 0, -.75), (-.5, .1, .02, .03, -.8),
                                                       (.5, -.3, .1, -.02, -.85), (.1, .6, .06, -.04, -.7)]):
                files.write_png(folder / f"{camera}{n}.png", width, height, render(camera, turn, tilt, (x, y, z)))
                rows.append(f"{camera}{n}.png,{n},0.01,1")
            (folder / f"{camera}.csv").write_text("\n".join(rows) + "\n")
        (folder / "capture.toml").write_text("version = 1\n" + "".join(
            f'[[camera]]\nname = "{c}"\nrole = "view"\nwidth = {width}\nheight = {height}\nprojection = "pinhole"\n'
            f'focal_px = [{focal}, {focal}]\nresponse = "linear"\nframes = "{c}.csv"\n' for c in ("left", "right")))
        return folder

    def check_lenses(self, capture, board, exact):
        """What --lenses says of the lenses counts in the stated uncertainty."""
        self.assertTrue(all(c["lens_exact"] for c in exact["cameras"]))
        manifest, out = (capture / "capture.toml").read_text(), self.root / "unsure.toml"
        lenses = []
        for table in manifest.split("[[camera]]")[1:]:
            lens = self.root / f"lens{len(lenses)}.toml"
            unsure = [0.0] * 16
            unsure[0] = unsure[5] = 9.0  # focal lengths by 3 px
            table = "\n".join(line for line in table.splitlines() if not line.startswith(("frames", "response")))
            lens.write_text(f"version = 1\n[[camera]]{table}\n[calibration]\ncovariance = {unsure}\n")
            lenses.append(lens)
        given = ["calibrate", "rig", capture, *board, "-o", out, "--lenses", ",".join(map(str, lenses))]
        printed = self.run_json(*given)
        self.assertFalse(any(c["lens_exact"] for c in printed["cameras"]))
        self.assertEqual(printed["cameras"][1]["position_m"], exact["cameras"][1]["position_m"])
        self.assertGreater(max(printed["cameras"][1]["position_sigma_m"]),
                           1.5 * max(exact["cameras"][1]["position_sigma_m"]))
        self.expect_refusal([lenses[0].name, "second lens"], *given[:-1], f"{lenses[0]},{lenses[0]}")
        lenses[0].write_text(lenses[0].read_text().replace("covariance", "rms_px"))
        self.expect_refusal([lenses[0].name, "covariance"], *given)
        lenses[0].write_text(lenses[0].read_text().replace('"left"', '"other"'))
        self.expect_refusal([lenses[0].name, "other"], *given)

    def test_a_board_is_a_page_to_print(self):
        page = self.root / "board.pdf"
        for board in ("charuco:5x8:0.03:0.022:24", "apriltag:4x5:0.03:0.01"):
            self.run_well("calibrate", "board", "--board", board, "--paper", "letter", "-o", page)
            written = page.read_bytes()
            self.assertTrue(written.startswith(b"%PDF-1.4"))
            self.assertIn(f"(--board {board})".encode(), written)
            described = self.run_json("inspect", page)
            self.assertEqual((described["kind"], described["board"]), ("calibration board", board))
            self.assertEqual(sorted(described["page_mm"]), [216, 279])
        page.write_bytes(written.replace(b"--board", b"no text"))
        self.expect_refusal(["board.pdf", "no page of a calibration board"], "inspect", page)
        page.unlink()
        self.expect_refusal(["360 x 360 mm", "does not fit A4"], "calibrate", "board", "--board", "charuco:9x9:0.04:0.03",
                            "-o", page)
        self.expect_refusal(["a5", "neither a4 nor letter"], "calibrate", "board", "--paper", "a5", "-o", page)
        self.assertFalse(page.exists())

    def test_poses_of_two_cameras_are_one_file_that_a_rig_reads(self):
        capture, out, report = self.stereo(self.root / "stereo"), self.root / "poses.toml", self.root / "rig"
        board = ["--board", "chessboard:7x5:0.04"]
        printed = self.run_json("calibrate", "rig", capture, *board, "-o", out, "--report", report)
        self.assertEqual([c["name"] for c in printed["cameras"]], ["left", "right"])
        right = printed["cameras"][1]
        for found, truth, sigma in zip(right["position_m"], (.12, 0, 0), right["position_sigma_m"]):
            self.assertAlmostEqual(found, truth, delta=.004)
            self.assertLess(sigma, .004)
        for found, truth in zip(right["rotation_xyzw"], (0, math.sin(math.radians(3)), 0, math.cos(math.radians(3)))):
            self.assertAlmostEqual(abs(found), truth, delta=.004)
        self.assertEqual(sorted(p.name for p in report.iterdir()), ["rig.csv", "rig.svg"])
        self.assertEqual([c["name"] for c in self.run_json("inspect", out)["cameras"]], ["left", "right"])
        self.check_lenses(capture, board, printed)
        (capture / "poses.toml").write_text(out.read_text())
        manifest = (capture / "capture.toml").read_text()
        (capture / "capture.toml").write_text(manifest.replace('role = "view"\n', 'role = "view"\npose = "poses.toml"\n'))
        self.run_json("inspect", capture)
        (capture / "poses.toml").write_text(out.read_text().replace('"right"', '"other"'))
        self.expect_refusal(["capture.toml", "pose", '"right"'], "inspect", capture)
        (capture / "poses.toml").write_text(out.read_text().replace('"first camera"', '"tracked body"'))
        self.expect_refusal(["capture.toml", "pose", "tracked body"], "inspect", capture)
        (capture / "capture.toml").write_text(manifest)
        # On the floor: the cameras look at the board from above its plane. A hand that moves it is found out.
        self.expect_refusal(["--board-plane", "moved"], "calibrate", "rig", capture, *board, "--board-plane", "floor",
                            "-o", self.root / "no.toml")
        floor = self.run_json("calibrate", "rig", capture, *board, "--board-plane", "floor", "--min-interval", 100, "-o", out)
        self.assertGreater(floor["cameras"][0]["position_m"][1], .6)
        self.expect_refusal(["left", "one camera alone"], "calibrate", "rig", capture, *board, "--cameras", "left", "-o",
                            self.root / "no.toml")
        tracker = self.root / "tracker.csv"
        refused = ["calibrate", "rig", capture, *board, "-o", self.root / "no.toml"]
        tracker.write_text("time_s,tx,ty,tz,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0,0,0,0,0,0,0,1\n")
        self.expect_refusal(["tracker.csv:3", "later"], *refused, "--tracker", tracker)
        tracker.write_text("time_s,tx,ty,tz,qx,qy,qz,qw\n0,0,0,0,0,0,0,2\n")
        self.expect_refusal(["tracker.csv:2", "quaternion"], *refused, "--tracker", tracker)
        self.expect_refusal(["--board-plane", "floor nor wall"], *refused, "--board-plane", "table")
        self.expect_refusal(["none of 8 pictures"], *refused[:3], "--board", "chessboard:11x8:0.04", *refused[5:])
        self.expect_refusal(["middle", "not a camera"], *refused, "--cameras", "left,middle")
        self.assertFalse((self.root / "no.toml").exists())

    def turned(self, folder, late_s):
        """A camera that a hand turns to and fro before a board, and its poses by a tracker whose clock is ahead."""
        folder.mkdir()
        width, height, focal, fps = 320, 240, 330, 12
        turn = lambda t: .3 * math.sin(2.1 * t) + .12 * math.sin(5.3 * t + 1)
        tilt = lambda t: .5 + .2 * math.sin(3.4 * t)
        rows = ["file,time_s,exposure_s,gain"]
        for n in range(32):
            cy, sy = math.cos(turn(n / fps)), math.sin(turn(n / fps))
            cx, sx = math.cos(tilt(n / fps)), math.sin(tilt(n / fps))
            files.write_png(folder / f"{n}.png", width, height, self.chessboard(
                width, height, focal, .04, (cy, sx * sy, -cx * sy), (0, cx, sx), (.01, .02, -.6)))
            rows.append(f"{n}.png,{n / fps},0.01,1")
        (folder / "frames.csv").write_text("\n".join(rows) + "\n")
        (folder / "capture.toml").write_text(
            f'version = 1\n[[camera]]\nname = "view"\nrole = "view"\nwidth = {width}\nheight = {height}\n'
            f'projection = "pinhole"\nfocal_px = [{focal}, {focal}]\nresponse = "linear"\nframes = "frames.csv"\n')

        def times(a, b):
            (ax, ay, az, aw), (bx, by, bz, bw) = a, b
            return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
                    aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)

        poses = ["time_s,tx,ty,tz,qx,qy,qz,qw"]
        for n in range(-60, 460):
            t = n / 120
            back = times((0, -math.sin(turn(t) / 2), 0, math.cos(turn(t) / 2)),
                         (-math.sin(tilt(t) / 2), 0, 0, math.cos(tilt(t) / 2)))
            poses.append(",".join(map(repr, (t + late_s, 0., 1., 0.) + times(back, (.6, 0, .48, .64)))))
        (folder / "tracker.csv").write_text("\n".join(poses) + "\n")
        return folder

    def test_a_tracker_that_turns_with_a_camera_tells_its_latency(self):
        capture, report = self.turned(self.root / "turned", .0435), self.root / "latency"
        given = ["calibrate", "latency", capture, "--board", "chessboard:7x5:0.04", "--tracker", capture / "tracker.csv"]
        poses = self.root / "body.toml"
        identity = [float(i % 5 == 0) for i in range(16)]
        poses.write_text('version = 1\n# by hand\n[rig]\nframe = "tracked body"\ntracker_offset_s = -0.01  # old\n'
                         f'\n[[camera]]\nname = "view"\nworld_from_camera = {identity}\n')
        printed = self.run_json(*given, "--report", report, "--pose-file", poses)
        self.assertAlmostEqual(printed["tracker_offset_s"], .0435, delta=3 * printed["tracker_offset_sigma_s"])
        self.assertLess(printed["tracker_offset_sigma_s"], .002)
        self.assertEqual(printed["boards"], 32)
        self.assertEqual(sorted(p.name for p in report.iterdir()), ["latency.csv", "latency.svg"])
        table = (report / "latency.csv").read_text().splitlines()
        self.assertEqual(table[0], "time_s,camera_deg_s,tracker_deg_s")
        self.assertEqual(len(table), printed["turns"] + 1)
        text = poses.read_text()
        self.assertIn(f"tracker_offset_s = {printed['tracker_offset_s']:.6f}", text)
        self.assertIn("# by hand", text)
        self.assertNotIn("# old", text)
        self.run_json("inspect", poses)
        self.assertIn("tracker time = camera time + 43", self.run_well(*given))
        before = poses.read_bytes()
        self.expect_refusal(["10 ms apart", "--max-offset"], *given, "--max-offset", .01, "--pose-file", poses)
        self.expect_refusal(["--max-offset", "10 s"], *given, "--max-offset", -1)
        self.expect_refusal(["side", "not a camera"], *given, "--camera", "side")
        self.assertEqual(poses.read_bytes(), before)
        poses.write_text(poses.read_text().replace('"view"', '"other"'))
        self.expect_refusal(["body.toml", 'no camera "view"'], *given, "--pose-file", poses)
        poses.write_text(poses.read_text().replace("tracked body", "board"))
        self.expect_refusal(["body.toml", "tracked body"], *given, "--pose-file", poses)
        still = capture / "still.csv"
        still.write_text("time_s,tx,ty,tz,qx,qy,qz,qw\n" + "".join(f"{n / 60 - 1},0,0,0,0,0,0,1\n" for n in range(300)))
        self.expect_refusal(["tracker turns by 0.0 degrees"], *given[:-1], still)

    def test_what_cannot_be_calibrated_is_refused(self):
        out = self.root / "none.toml"
        grey = self.root / "grey.png"
        files.write_png(grey, 64, 48, lambda x, y: (128, 128, 128))
        board = ["--board", "chessboard:9x6:0.03"]
        self.expect_refusal(["none of 1 pictures", "--board"], "calibrate", "camera", grey, *board, "-o", out)
        self.expect_refusal(["chessboard:9", "expected"], "calibrate", "camera", grey, "--board", "chessboard:9", "-o",
                            out)
        self.expect_refusal(["either pictures or --capture"], "calibrate", "camera", *board, "-o", out)
        self.expect_refusal(["latlong", "has nothing to calibrate"], "calibrate", "camera", grey, *board, "--projection",
                            "latlong", "-o", out)
        self.assertFalse(out.exists())


if __name__ == "__main__":
    sys.exit(main(__name__))
