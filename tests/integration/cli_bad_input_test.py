#!/usr/bin/env python3
"""Every bad input is one line that names the thing, status 2, and leaves nothing behind.
cli_bad_input_test.py PROGRAM [CLASS...]"""

import shutil
import re
import subprocess
import sys

import cli_files as files
from cli_case import PATIENCE, CliTest, main, program


class BadImages(CliTest):
    @classmethod
    def make_files(cls):
        for name, code in (("a", 30), ("b", 120), ("black", 0), ("black2", 0), ("white", 255), ("white2", 255)):
            files.write_png(cls.root / f"{name}.png", 40, 20, lambda x, y, c=code: (c and min(255, c + x),) * 3)
        files.write_png(cls.root / "narrow.png", 39, 20, lambda x, y: (60, 60, 60))
        whole = (cls.root / "a.png").read_bytes()
        (cls.root / "cut.png").write_bytes(whole[:len(whole) // 2])
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))
        (cls.root / "cut.hdr").write_bytes((cls.root / "even.hdr").read_bytes()[:3000])
        (cls.root / "text.hdr").write_text("not a picture")
        (cls.root / "nothing.hdr").write_bytes(b"")

    def refuse(self, words, images, times, response="linear"):
        self.expect_refusal(words, "hdr", "merge", *[self.root / i for i in images], f"--times={times}", "--response",
                            response, "-o", self.root / "out" / "merged.exr")

    def test_missing_and_truncated_images(self):
        self.refuse(["nowhere.png"], ["a.png", "nowhere.png"], "0.1,0.4")
        self.refuse(["cut.png"], ["a.png", "cut.png"], "0.1,0.4")
        self.refuse(["nowhere.toml"], ["a.png", "b.png"], "0.1,0.4", "nowhere.toml")
        for name in ("nowhere.hdr", "cut.hdr", "text.hdr", "nothing.hdr"):
            self.expect_refusal([name], "light", "estimate", self.root / name)
            self.expect_refusal([name], "inspect", self.root / name)
            self.expect_refusal([name], "demo", "--headless", "--environment", self.root / name, "--out",
                                self.root / "out" / "demo")

    def test_images_of_different_sizes(self):
        self.refuse(["narrow.png", "39x20"], ["a.png", "narrow.png"], "0.1,0.4")

    def test_times_that_are_no_exposures(self):
        for times in ("0,0.4", "0.1,-0.4", "-0.1,0.4", "nan,0.4", "0.1,inf", "0.1,", "0.1", "0.1,0.2,0.3", "a,b", "1/0,1"):
            self.refuse(["times"], ["a.png", "b.png"], times)

    def test_unknown_times_that_cannot_be_found(self):
        self.refuse(["no time is given"], ["a.png", "b.png"], "?,?")
        self.refuse(["picture 2", "neither clipped nor dark"], ["black.png", "white.png"], "1,?")
        self.expect_refusal(["needs --response"], "hdr", "merge", self.root / "a.png", self.root / "b.png", "--times", "1,?",
                            "-o", self.root / "out" / "merged.exr")

    def test_references_and_alignment_that_cannot_be(self):
        for words, options in ((["reference", "2 pictures"], ["--reference", 3]), (["picture 1", "in common"], ["--align"])):
            self.expect_refusal(words, "hdr", "merge", self.root / "a.png", self.root / "b.png", "--times", "0.1,0.4",
                                "--response", "linear", *options, "-o", self.root / "out" / "merged.exr")

    def test_all_black_and_all_clipped(self):
        for response in ("linear", "srgb"):
            self.refuse(["black"], ["black.png", "black2.png"], "0.1,0.4", response)
            self.refuse(["clipped"], ["white.png", "white2.png"], "0.1,0.4", response)
        for pair in (["black.png", "black2.png"], ["white.png", "white2.png"]):  # response to be estimated
            self.expect_refusal([], "hdr", "merge", *[self.root / i for i in pair], "--times", "0.1,0.4", "-o",
                                self.root / "out" / "merged.exr")


class BadMeshes(CliTest):
    @classmethod
    def make_files(cls):
        files.write_scene(cls.root)
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))
        vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
        meshes = {"empty.obj": "", "faceless.obj": vertices, "degenerate.obj": vertices + "f 1 1 2\nf 3 3 3\n",
                  "flat.obj": "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "nan.obj": "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
                  "infinite.obj": "v 0 inf 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
                  "far.obj": "v 1e30 0 0\nv 0 1e30 0\nv 0 0 1e30\nf 1 2 3\n"}
        for name, text in meshes.items():
            (cls.root / name).write_text(text)
        header = ("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n"
                  "element face 0\nproperty list uchar int vertex_indices\nend_header\n")
        (cls.root / "empty.ply").write_text(header)
        (cls.root / "cut.glb").write_bytes(b"glTF\2\0\0\0\xff\0\0\0")
        cls.names = [*meshes, "empty.ply", "cut.glb", "nowhere.obj"]

    def test_bake_refuses_meshes_without_a_surface(self):
        for name in self.names:
            self.expect_refusal([name], "bake", self.root / name, "-o", self.root / "out" / "baked.glb", "--samples", 64)
        self.expect_refusal(["builtin:cow"], "bake", "builtin:cow", "-o", self.root / "out" / "baked.glb")

    def test_render_refuses_them_in_a_scene(self):
        for name in self.names:
            for section in ("object", "real"):
                key = "asset" if section == "object" else "mesh"
                (self.root / "bad.toml").write_text(f'version = 1\n[[{section}]]\n{key} = "{name}"\n')
                self.expect_refusal([name], "render", "--scene", self.root / "bad.toml", "--environment",
                                    self.root / "even.hdr", "--camera", self.root / "camera.toml", "-o",
                                    self.root / "out" / "picture.exr")

    def test_demo_refuses_them_as_its_asset_and_prop(self):
        for name in ("empty.obj", "nan.obj", "nowhere.obj"):
            self.expect_refusal([name], "demo", "--headless", "--frames", 1, "--width", 64, "--height", 64, "--environment",
                                self.root / "even.hdr", "--asset", self.root / name, "--out", self.root / "out" / "demo")
            self.expect_refusal([name], "demo", "--headless", "--frames", 1, "--width", 64, "--height", 64, "--environment",
                                self.root / "even.hdr", "--real-mesh", self.root / name, "--out", self.root / "out" / "demo")


class BadConfiguration(CliTest):
    @classmethod
    def make_files(cls):
        files.write_scene(cls.root)
        files.write_capture(cls.root / "capture")
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))

    def spoiled(self, name, text):
        (self.root / name).write_text(text)
        return self.root / name

    def test_unknown_keys_are_named_with_file_and_line(self):
        rig = self.spoiled("rig.toml", 'version = 1\n[capture]\nsource = "studio"\ncolour = 3\n')
        self.expect_refusal(["rig.toml:4", "colour"], "serve", "--config", rig)
        scene = self.spoiled("odd.toml", files.SCENE + "colour = 3\n")
        line = f"odd.toml:{files.SCENE.count(chr(10)) + 1}"
        self.expect_refusal([line, "colour"], "composite", "--capture", self.root / "capture", "--scene", scene, "--out",
                            self.root / "out" / "run")
        render = ["render", "--environment", self.root / "even.hdr", "-o", self.root / "out" / "picture.exr"]
        self.expect_refusal([line, "colour"], *render, "--scene", scene, "--camera", self.root / "camera.toml")
        camera = self.spoiled("odd-camera.toml", files.CAMERA + "colour = 3\n")
        self.expect_refusal(["odd-camera.toml:", "colour"], *render, "--scene", self.root / "scene.toml", "--camera", camera)
        self.expect_refusal(["odd.toml:", "colour"], "inspect", scene)

    def test_old_names_are_refused_with_the_new_ones(self):
        rig = self.spoiled("old.toml", 'version = 1\n[capture]\nsource = "studio"\n[light]\ndiscs = 3\n')
        self.expect_refusal(["old.toml:5", "discs", "max_lights"], "serve", "--config", rig)
        scene = self.spoiled("old-scene.toml", files.SCENE + "stand_size_m = 3\n")
        self.expect_refusal(["old-scene.toml:", "stand_size_m", "fit_size_m"], "inspect", scene)
        self.expect_refusal(["--discs", "--max-lights"], "demo", "--discs", 3)
        self.expect_refusal(["--budget", "--max-shadow-error"], "composite", "--budget=0.1")

    def test_mistyped_words_get_the_nearest_known_one(self):
        self.expect_refusal(["lihgt", "did you mean light?"], "lihgt", "estimate", self.root / "even.hdr")
        self.expect_refusal(["mergge", "did you mean merge?"], "hdr", "mergge")
        self.expect_refusal(["--band", "did you mean --bands?"], "light", "estimate", self.root / "even.hdr", "--band", 3)
        self.expect_refusal(["teapot", "inspect"], "teapot")
        self.expect_refusal(["--rotate-environment", "--environment"], "demo", "--rotate-environment", 90)
        rig = self.spoiled("near.toml", 'version = 1\n[capture]\nsourse = "studio"\n')
        self.expect_refusal(["near.toml:3", 'did you mean "source"?'], "serve", "--config", rig)

    def test_missing_and_damaged_files(self):
        self.expect_refusal(["nowhere.toml"], "serve", "--config", self.root / "nowhere.toml")
        broken = self.spoiled("broken.toml", "version = 1\n[capture\n")
        self.expect_refusal(["broken.toml:2"], "serve", "--config", broken)
        self.expect_refusal(["broken.toml:2"], "composite", "--capture", self.root / "capture", "--scene", broken, "--out",
                            self.root / "out" / "run")

    def test_addresses_that_are_not_loopback(self):
        rig = self.spoiled("open.toml", 'version = 1\n[capture]\nsource = "studio"\n[http]\naddress = "0.0.0.0"\n')
        self.expect_refusal(["open.toml:5", "loopback"], "serve", "--config", rig)

    def test_arguments_that_do_not_exist(self):
        self.expect_refusal(["--headles", "did you mean --headless?"], "demo", "--headles")
        self.expect_refusal(["dance", "no command"], "dance")
        self.expect_refusal(["command: is missing", "composite"])
        self.expect_refusal(["extra: is not expected here"], "inspect", "file", "extra")

    def test_arguments_that_do_not_fit(self):
        out = self.root / "out.exr"
        for words, *arguments in (
                (["--frames", '"x" is not a whole number'], "demo", "--frames", "x"),
                (["--error", '"x" is not a number'], "render", "--error", "x"),
                (["--scene: is missing"], "composite", "--capture", self.root),
                (["--scene: needs a value"], "composite", "--scene"),
                (["--capture: is given more than once"], "composite", "--capture", "a", "--capture", "b"),
                (["--at: is not above 0"], "hdr", "environment", "a", "-o", out, "--at", 0),
                (["--albedo: is not within 0..1"], "bake", "builtin:box", "-o", out, "--albedo", 2, 2, 2),
                (["--fps: needs --animation"], "bake", "builtin:box", "-o", out, "--fps", 10),
                (["--governor: cannot go with --animation"], "chart", "--animation", "Walk", "--governor", 3),
                (["--bits: needs --through-sensor"], "chart", "--bits", 12),
                (["--bits: is neither 8 nor 12"], "chart", "--through-sensor", "--bits", 9),
                (["--view-lens: is none of pinhole"], "chart", "--through-sensor", "--view-lens", "bent"),
                (["--shortest-exposure", "1/30 s"], "chart", "--through-sensor", "--shortest-exposure", 1),
                (["--projection", "kb4 is none of"], "light", "estimate", "a.hdr", "--projection", "kb4"),
                (["--budget: is not expected here"], "inspect", "a", "--budget"),
                (["--budget: is now --max-shadow-error"], "chart", "--budget", 1)):
            self.expect_refusal(words, *arguments)

    def test_commands_of_other_programs_are_those_programs(self):
        for command in (["demo"], ["calibrate", "camera"], ["chart"], ["compare"]):
            one = subprocess.run([program(), *command, "--help"], capture_output=True, text=True, check=True).stdout
            self.assertEqual(one, self.run_well(*command, "--help"))
            self.assertIn("--json" if command[0] != "demo" else "--headless", one)

    def test_help_fits_the_screen(self):
        for command in ((), ("demo",), ("bake",), ("chart",), ("calibrate", "camera"), ("render",)):
            shown = self.run_well(*command, "--help")
            self.assertLessEqual(max(map(len, shown.splitlines())), 130, command)
            for internal in ("FLOAT", "INT", "TEXT", "{false}", "Excludes"):
                self.assertNotIn(internal, shown, command)


class BadCaptures(CliTest):
    @classmethod
    def make_files(cls):
        files.write_scene(cls.root)

    def capture(self, **made):
        folder = self.root / "capture"
        shutil.rmtree(folder, ignore_errors=True)
        files.write_capture(folder, **made)
        return folder

    def refuse(self, words, folder):
        self.expect_refusal(words, "composite", "--capture", folder, "--scene", self.root / "scene.toml", "--out",
                            self.root / "out" / "run", "--bands", 2)

    def edit(self, path, before, after):
        text = path.read_text()
        self.assertIn(before, text)
        path.write_text(text.replace(before, after, 1))

    def test_good_capture_is_composited(self):
        self.run_well("composite", "--capture", self.capture(), "--scene", self.root / "scene.toml", "--out",
                      self.root / "good", "--bands", 2)
        self.assertEqual(len(list((self.root / "good").glob("frame_*.png"))), 3)

    def test_moves_put_objects_elsewhere_and_bad_ones_are_refused(self):
        moves = self.root / "moves.csv"
        head = "time_s,object,x_m,y_m,z_m,turn_deg\n"
        command = ("composite", "--capture", self.capture(), "--scene", self.root / "scene.toml", "--bands", 2)
        pictures = []
        for x in (0, .4):
            moves.write_text(f"{head}0,cube,{x},0,0,0\n")
            self.run_well(*command, "--moves", moves, "--out", self.root / f"moved-{x}")
            pictures.append((self.root / f"moved-{x}" / "frame_000000.png").read_bytes())
        self.assertNotEqual(*pictures)
        for words, text in ((["moves.csv", "cubes"], head + "0,cubes,0,0,0,0\n"),
                            (["moves.csv:2", "not a number"], head + "0,cube,0,x,0,0\n"),
                            (["cube", "below"], head + "0,cube,0,-3,0,0\n"), (["moves.csv:1"], "0,cube,0,0,0,0\n")):
            moves.write_text(text)
            self.expect_refusal(words, *command, "--moves", moves, "--out", self.root / "out" / "refused")

    def test_surroundings_of_no_capture(self):
        for words, capture in ((["nowhere"], self.root / "nowhere"), (["scene.toml"], self.root / "scene.toml")):
            self.expect_refusal(words, "hdr", "environment", capture, "-o", self.root / "out" / "seen.exr")

    def test_missing_folder_and_files(self):
        self.refuse(["nowhere"], self.root / "nowhere")
        folder = self.capture()
        (folder / "view" / "1.png").unlink()
        self.refuse(["view/1.png"], folder)

    def test_truncated_and_resized_pictures(self):
        for camera in ("environment", "view"):
            folder = self.capture()
            whole = (folder / camera / "1.png").read_bytes()
            (folder / camera / "1.png").write_bytes(whole[:len(whole) // 2])
            self.refuse([f"{camera}/1.png"], folder)
            files.write_png(folder / camera / "1.png", 30, 20, lambda x, y: (50, 50, 50))
            self.refuse([f"{camera}/1.png", "30x20"], folder)

    def test_exposures_that_are_none(self):
        for bad in ("0", "-0.01", "nan", "inf", "abc", ""):
            self.refuse(["environment.csv:2"], self.capture(exposures=(bad, "0.04")))

    def test_unknown_keys_and_columns(self):
        folder = self.capture()
        self.edit(folder / "capture.toml", 'name = "view"', 'colour = 3\nname = "view"')
        self.refuse(["capture.toml:13", "colour"], folder)
        folder = self.capture()
        self.edit(folder / "view.csv", "gain", "gain,iso")
        self.refuse(["view.csv", "iso"], folder)

    def test_environment_that_is_all_black_or_all_clipped(self):
        self.refuse(["black"], self.capture(codes=(0, 0)))
        self.refuse(["clipped"], self.capture(codes=(255, 255)))


class BadOutputs(CliTest):
    @classmethod
    def make_files(cls):
        files.write_scene(cls.root)
        files.write_capture(cls.root / "capture")
        files.write_hdr(cls.root / "even.hdr", 64, 32, (1.0, 0.5, 0.25))
        (cls.root / "plain").write_text("a file")
        cls.below = cls.root / "plain" / "below"

    def test_output_below_a_regular_file(self):
        pictures = [self.root / "capture" / "environment" / f"{i}.png" for i in range(2)]
        self.expect_refusal(["plain"], "hdr", "merge", *pictures, "--times", "0.01,0.04", "--response", "srgb", "-o",
                            self.below / "merged.exr")
        self.expect_refusal(["plain"], "bake", self.root / "cube.obj", "-o", self.below / "cube.glb", "--samples", 64)
        self.expect_refusal(["plain"], "render", "--scene", self.root / "scene.toml", "--environment",
                            self.root / "even.hdr", "--camera", self.root / "camera.toml", "--without-objects", "-o",
                            self.below / "picture.exr")
        self.expect_refusal(["plain"], "composite", "--capture", self.root / "capture", "--scene",
                            self.root / "scene.toml", "--out", self.below)
        self.expect_refusal(["plain"], "demo", "--headless", "--out", self.below)
        self.expect_refusal(["plain"], "demo", "--headless", "--frames", 1, "--width", 64, "--height", 64, "--environment",
                            self.root / "even.hdr", "--asset", self.root / "cube.obj", "--no-turntable", "--bands", 1,
                            "--out", self.root / "out" / "demo", "--record", self.below)
        self.assertEqual((self.root / "plain").read_text(), "a file")

    def test_disk_that_fills_up_while_a_bake_is_written(self):
        out = self.root / "out"
        out.mkdir(exist_ok=True)
        baked = out / "cube.glb"
        baked.write_text("earlier")
        script = "trap '' XFSZ; ulimit -f 40; exec \"$@\""
        done = subprocess.run(["sh", "-c", script, "sh", program(), "bake", str(self.root / "cube.obj"), "-o", str(baked),
                               "--samples", "64"], env=self.environment, capture_output=True, text=True,
                              timeout=300 * PATIENCE, check=False)
        self.assertEqual(done.returncode, 2, done.stdout + done.stderr)
        self.assertIn("cube.glb", done.stderr.splitlines()[-1])
        self.assertEqual(baked.read_text(), "earlier")
        self.assertEqual([p.name for p in out.iterdir()], ["cube.glb"])

    def test_a_bake_that_finds_no_memory(self):
        if PATIENCE > 1:
            self.skipTest("sanitizers take address space by the terabyte")
        out = self.root / "out"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        baked = out / "ball.glb"
        reasons = []

        def run_within(megabytes, *arguments):
            return subprocess.run(["sh", "-c", f"ulimit -v {megabytes}000; exec \"$@\"", "sh", program(), *arguments],
                                  env=self.environment, capture_output=True, text=True, timeout=300 * PATIENCE, check=False)

        # What the libraries take before the bake differs from machine to machine.
        fewest = next(m for m in range(200, 4000, 20) if run_within(m, "--version").returncode == 0)
        for megabytes in range(fewest, fewest + 1000, 20):
            done = run_within(megabytes, "bake", "builtin:ball", "--samples", "64", "-o", str(baked))
            if done.returncode == 0:
                break
            self.assertEqual(done.returncode, 2, done.stdout + done.stderr)
            reasons.append(done.stderr.splitlines()[-1])
            self.assertTrue(reasons[-1].startswith("penumbra: "), reasons[-1])
            self.assertEqual([p.name for p in out.iterdir()], [])
        self.assertEqual(done.returncode, 0, "no memory is enough")
        self.assertTrue(any("memory" in r for r in reasons), reasons)

    def test_numbers_out_of_range_name_their_option(self):
        baked = self.root / "out" / "cube.glb"
        self.expect_refusal(["--bands"], "bake", self.root / "cube.obj", "-o", baked, "--bands", 0)
        self.expect_refusal(["--bounces"], "bake", self.root / "cube.obj", "-o", baked, "--bounces", -1)
        self.expect_refusal(["--samples"], "bake", self.root / "cube.obj", "-o", baked, "--samples", 65)
        self.expect_refusal(["--width"], "demo", "--headless", "--width", 0, "--out", self.root / "out")
        self.expect_refusal(["--height"], "demo", "--headless", "--height", 9999, "--out", self.root / "out")

    def test_camera_of_a_gigapixel(self):
        text = (self.root / "camera.toml").read_text()
        text = re.sub(r"(width|height) = \d+", r"\1 = 30000", text)
        (self.root / "huge.toml").write_text(text)
        self.expect_refusal(["huge.toml", "million"], "render", "--scene", self.root / "scene.toml", "--environment",
                            self.root / "even.hdr", "--camera", self.root / "huge.toml", "-o",
                            self.root / "out" / "picture.exr")

    def test_output_of_an_unknown_kind(self):
        pictures = [self.root / "capture" / "environment" / f"{i}.png" for i in range(2)]
        self.expect_refusal(["merged.txt"], "hdr", "merge", *pictures, "--times", "0.01,0.04", "--response", "srgb", "-o",
                            self.root / "out" / "merged.txt")
        self.expect_refusal(["cube.obj"], "bake", self.root / "cube.obj", "-o", self.root / "out" / "cube.obj")
        self.expect_refusal(["picture.png"], "render", "--scene", self.root / "scene.toml", "--environment",
                            self.root / "even.hdr", "--camera", self.root / "camera.toml", "-o",
                            self.root / "out" / "picture.png")


if __name__ == "__main__":
    sys.exit(main(__name__))
