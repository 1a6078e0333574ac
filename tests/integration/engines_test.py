#!/usr/bin/env python3
"""Follows the light from the daemon into engines and clients: engines_test.py DAEMON [CLASS...]

What they show is compared with a formula that is written here from the descriptions of the engines, and with nothing
of the service's own conversions. The client library is PENUMBRA_CLIENT_LIBRARY, else the one of the daemon's build.
PENUMBRA_THREE=FOLDER takes another three.js, with build/three.module.js in it. With PENUMBRA_SCREENSHOTS=FOLDER
pictures of the sphere are written there. Standard library only.
"""

import http.server
import importlib
import json
import math
import os
import random
import re
import shutil
import statistics
import struct
import subprocess
import sys
import threading
import time
import unittest
from pathlib import Path

import browser as web
from cli_case import PATIENCE, main, program
from daemon_case import Daemon

HERE = Path(__file__).resolve().parent
CLIENT = HERE.parents[1] / "service" / "client"
EXAMPLES = HERE.parents[1] / "docs" / "examples"
RIG = """version = 1
[capture]
source = "studio"
environment = "room.hdr"
width = 128
height = 96
[scene]
file = "scene.toml"
[light]
stale_after_s = 30
[http]
port = {port}
origins = {origins}
[output]
light_page = "page"
"""


# ---- Rooms. ----

def unit(*d):
    length = math.sqrt(sum(c * c for c in d))
    return tuple(c / length for c in d)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


# Walls that no mirror maps onto each other, and a lamp: without it signs of axes could not be seen.
MORNING = {"ambient": (.5, .6, .8), "walls": [(unit(.3, .2, 1), (2., .8, .4)), (unit(-1, .4, .3), (.2, .9, .3))],
           "lamp": (unit(.5, .8, .6), (90., 80., 60.))}
EVENING = {"ambient": (.7, .4, .3), "walls": [(unit(.5, -.3, -1), (.3, .5, 2.)), (unit(.9, .5, .2), (1.2, .2, .1))],
           "lamp": (unit(-.7, .5, -.4), (60., 35., 20.))}
LAMP_RADIUS_RAD = .12


def radiance(room, d):
    colour = list(room["ambient"])
    for towards, wall in room["walls"]:
        share = max(0, dot(d, towards)) ** 2
        colour = [c + share * w for c, w in zip(colour, wall)]
    towards, lamp = room["lamp"]
    return lamp if dot(d, towards) > math.cos(LAMP_RADIUS_RAD) else colour


def write_room(path, room, width=256, height=128):
    """A lat-long map as flat RGBE; -z is in its middle."""
    pixels = bytearray()
    for y in range(height):
        for x in range(width):
            theta, phi = math.pi * (y + .5) / height, 2 * math.pi * ((x + .5) / width - .5)
            d = (math.sin(theta) * math.sin(phi), math.cos(theta), -math.sin(theta) * math.cos(phi))
            colour = radiance(room, d)
            mantissa, exponent = math.frexp(max(colour))
            scale = mantissa * 256 / max(colour)
            pixels += bytes([int(c * scale) for c in colour] + [exponent + 128])
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    Path(path).write_bytes(head + pixels)


# ---- What the service's convention says. ----

def harmonics(d):
    """Three bands, orthonormal, without the Condon-Shortley phase."""
    x, y, z = d
    k1, k2 = math.sqrt(3 / (4 * math.pi)), math.sqrt(15 / (4 * math.pi))
    return [math.sqrt(1 / (4 * math.pi)), k1 * y, k1 * z, k1 * x, k2 * x * y, k2 * y * z,
            math.sqrt(5 / (16 * math.pi)) * (3 * z * z - 1), k2 * x * z, k2 / 2 * (x * x - y * y)]


BAND = [0, 1, 1, 1, 2, 2, 2, 2, 2]
SENT = [1, 2 / 3, 1 / 4]  # of each band's radiance by a white surface


def total(rows, weights):
    return [sum(row[c] * w for row, w in zip(rows, weights)) for c in range(3)]


def radiance_of(rows, d):
    return total(rows[:9], harmonics(d))


def sent_by_white(rows, n):
    """Irradiance over pi."""
    return total(rows[:9], [y * SENT[band] for y, band in zip(harmonics(n), BAND)])


def sent_by_white_in_all_light(light, n):
    out = sent_by_white(light["residual"]["coefficients"], n)
    for found in light["lights"]:
        share = found["solid_angle_sr"] * max(0, dot(n, found["direction"])) / math.pi
        out = [a + b * share for a, b in zip(out, found["radiance"])]
    return out


def differences(found, expected):
    """Of lists of colours: (largest, mean), relative to the mean of what is expected."""
    mean = statistics.fmean(abs(c) for colour in expected for c in colour)
    off = [abs(a - b) / mean for one, other in zip(found, expected) for a, b in zip(one, other)]
    return max(off), statistics.fmean(off)


# ---- What the engines say: axes of a world's direction, and a sum over coefficients. ----

def with_phase(x, y, z):
    """ARCore's and Unreal's basis: factors and signs as their sources have them."""
    return [.282095, -.488603 * y, .488603 * z, -.488603 * x, 1.092548 * x * y, -1.092548 * y * z,
            .315392 * (3 * z * z - 1), -1.092548 * x * z, .546274 * (x * x - y * y)]


def without_phase(x, y, z):
    """three.js's and WebXR's."""
    return [.282095, .488603 * y, .488603 * z, .488603 * x, 1.092548 * x * y, 1.092548 * y * z,
            .315392 * (3 * z * z - 1), 1.092548 * x * z, .546274 * (x * x - y * y)]


def filament(x, y, z):
    return [1, y, z, x, y * x, y * z, 3 * z * z - 1, z * x, x * x - y * y]


def unity(x, y, z):
    """SphericalHarmonicsL2 in the shader's vectors: A is linear, B has products, C the last one."""
    a = {3: x, 1: y, 2: z, 0: 1}
    b = {4: x * y, 5: y * z, 6: 3 * z * z, 7: z * x}
    c = {8: x * x - y * y}
    out = {**a, **b, **c}
    out[6] -= 1  # A's last component is the first coefficient less the seventh
    return [out[n] for n in range(9)]


ENGINES = {  # name: (axes, basis at what the shader asks for, "radiance" or "irradiance over pi")
    "three": (lambda x, y, z: (x, y, z), without_phase, "radiance"),
    "webxr": (lambda x, y, z: (x, y, z), without_phase, "radiance"),
    "arcore": (lambda x, y, z: (x, y, z), with_phase, "radiance"),
    "godot": (lambda x, y, z: (x, y, z), lambda x, y, z: without_phase(x, y, -z), "radiance"),
    "filament": (lambda x, y, z: (x, y, z), filament, "irradiance over pi"),
    "unity": (lambda x, y, z: (x, y, -z), unity, "irradiance over pi"),  # left-handed, z forward
    "unreal": (lambda x, y, z: (-z, x, y), with_phase, "radiance"),  # x forward, y right, z up
}


class Shared(Daemon):
    """A daemon in a room, and lights of it that belong together."""

    origins = ()
    port_number = 0

    @classmethod
    def make_files(cls):
        super().make_files()
        write_room(cls.root / "room.hdr", MORNING)
        (cls.root / "rig.toml").write_text(RIG.format(port=cls.port_number, origins=json.dumps(list(cls.origins))))

    @classmethod
    def light(cls):
        return cls.ask("GET", "/v1/light").json()

    @classmethod
    def wait_for_light(cls):
        cls.wait_for("light", lambda: cls.ask("GET", "/v1/light").status == 200)

    def of_one_time(self, other, time_of):
        """(light, other) of the same picture; other() asks for the other one."""
        for _ in range(int(400 * PATIENCE)):
            before, found, after = self.light(), other(), self.light()
            for light in (before, after):
                if found is not None and time_of(found) == light["time_ns"]:
                    return light, found
        self.fail("never of the same time")


class Conventions(Shared):
    """/v1/light?as=... by the polynomials that each engine has itself."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.wait_for_light()
        chance = random.Random(20261127)
        cls.directions = [unit(*(chance.gauss(0, 1) for _ in range(3))) for _ in range(50)]

    def read_by(self, name, rows):
        axes, basis, _ = ENGINES[name]
        return [total(rows, basis(*axes(*d))) for d in self.directions]

    def of_engine(self, name):
        return self.of_one_time(lambda: self.ask("GET", f"/v1/light?as={name}").json(), lambda a: a["time_ns"])

    def expected(self, name, rows):
        reader = sent_by_white if ENGINES[name][2] == "irradiance over pi" else radiance_of
        return [reader(rows, d) for d in self.directions]

    def test_each_engine_reads_the_same_light(self):
        for name, (axes, _, kind) in ENGINES.items():
            with self.subTest(name):
                light, answer = self.of_engine(name)
                self.assertEqual((answer["convention"], answer["sh_is"]), (name, kind))
                for key, rows in (("sh", light["residual"]["coefficients"]), ("total_sh", light["coefficients"])):
                    self.assertEqual(len(answer[key]), 9)
                    worst, _ = differences(self.read_by(name, answer[key]), self.expected(name, rows))
                    print(f"{name} {key}: {worst:.1e} of the mean at most")
                    self.assertLess(worst, 1e-4, key)
                self.assertTrue(light["lights"])
                self.assertEqual(len(answer["lights"]), len(light["lights"]))
                for found, ours in zip(answer["lights"], light["lights"]):
                    self.assertEqual(found["id"], ours["id"])
                    for a, b in zip(found["direction"], axes(*ours["direction"])):
                        self.assert_close(a, b, 1e-5)
                    for a, b in zip(found["irradiance"], ours["radiance"]):
                        self.assert_close(a, b * ours["solid_angle_sr"], 1e-4 * a)
                    self.assert_close(found["angular_diameter_deg"], math.degrees(2 * ours["radius_rad"]), 1e-4)

    def test_another_engines_signs_are_seen(self):
        """The comparison is worth something only if it fails with coefficients that are made for another engine."""
        pairs = (("three", "arcore"), ("three", "godot"), ("arcore", "godot"), ("filament", "unity"),
                 ("three", "unreal"), ("arcore", "unreal"))
        for ours, others in pairs:
            light, answer = self.of_engine(others)
            worst, mean = differences(self.read_by(ours, answer["sh"]),
                                      self.expected(ours, light["residual"]["coefficients"]))
            print(f"{others}'s coefficients in {ours}: {worst:.0%} off at most, {mean:.0%} on average")
            self.assertGreater(worst, .1, f"{others} in {ours}")


class Filament(Shared):
    """Filament's own tool measures the service's map; its coefficients are those of as=filament."""

    @classmethod
    def make_files(cls):
        if not shutil.which("cmgen"):
            raise unittest.SkipTest("Filament's cmgen is not installed")
        super().make_files()

    def light_and_map(self):
        """Of one light: that of the first bracket still changes, and a map follows its light."""
        def light():
            return self.ask("GET", "/v1/light?as=filament").json()["total_sh"]
        for _ in range(int(30 * PATIENCE)):
            before = light()
            time.sleep(1)
            answer, after = self.ask("GET", "/v1/environment.exr"), light()
            apart = max(abs(a - b) for x, y in zip(before, after) for a, b in zip(x, y))
            if answer.status == 200 and apart < .002 * max(map(abs, after[0])):
                return after, answer.body
        raise AssertionError("the light does not come to rest")

    def measured(self, *options):
        subprocess.run(["cmgen", "--quiet", "--sh=3", "--sh-shader", "--sh-window=no", *options,
                        f"--sh-output={self.root / 'sh.txt'}", self.root / "map.exr"], check=True,
                       timeout=120 * PATIENCE, capture_output=True)
        lines = (self.root / "sh.txt").read_text(encoding="utf-8").splitlines()
        return [[float(c) for c in re.match(r"\(([^)]*)\)", line)[1].split(",")] for line in lines]

    def test_its_tool_finds_the_same_light(self):
        self.wait_for_light()
        ours, environment = self.light_and_map()
        (self.root / "map.exr").write_bytes(environment)
        chance = random.Random(20261127)
        directions = [unit(*(chance.gauss(0, 1) for _ in range(3))) for _ in range(50)]
        expected = [total(ours, filament(*d)) for d in directions]

        def off(rows):  # its maps have +z in their middle, ours -z: half a turn
            return differences([total(rows, filament(-x, y, -z)) for x, y, z in directions], expected)
        worst, mean = off(self.measured())
        print(f"Filament's cmgen: {worst:.2%} off at most, {mean:.2%} on average")
        self.assertLess(worst, .02)
        self.assertGreater(off(self.measured("--no-mirror"))[0], .1)  # a mirrored room


# ---- three.js. ----

def three_folder():
    """The one with build/three.module.js in it, or None."""
    named = os.environ.get("PENUMBRA_THREE")
    for folder in [named] if named else ["/usr/share/javascript/three", "/usr/share/nodejs/three"]:
        if (Path(folder) / "build" / "three.module.js").is_file():
            return Path(folder)
    return None


class Pages(http.server.SimpleHTTPRequestHandler):
    """The test's page, and three.js below /three/."""

    def translate_path(self, path):
        path = path.partition("?")[0]
        if path.startswith("/three/build/") and ".." not in path:
            return str(three_folder() / path.removeprefix("/three/"))
        return str(HERE / "engines_page.html") if path == "/" else "/nonexistent"

    def log_message(self, *_):
        pass


class Watch:
    """All lights of a daemon by their time, while it is used in `with`."""

    def __init__(self, case):
        self.case, self.lights, self.over = case, {}, threading.Event()
        self.thread = threading.Thread(target=self.read)

    def read(self):
        while not self.over.wait(.005):
            light = self.case.light()
            self.lights[light["time_ns"]] = light

    def __enter__(self):
        self.thread.start()
        return self.lights

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()


class ThreeJs(Shared):
    """A white sphere in three.js, in a page that is not the daemon's own."""

    @classmethod
    def make_files(cls):
        if not web.is_installed():
            raise unittest.SkipTest("chromium and chromedriver are not installed")
        if three_folder() is None:
            raise unittest.SkipTest("three.js is not installed")
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Pages)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        cls.addClassCleanup(server.server_close)
        cls.addClassCleanup(server.shutdown)
        cls.pages_port = server.server_port
        cls.origins = (f"http://127.0.0.1:{cls.pages_port}",)
        cls.port_number = web.free_port()
        super().make_files()

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        flags = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
        cls.browser = web.Browser(cls.root, PATIENCE, flags)
        cls.addClassCleanup(cls.browser.close)
        cls.wait_for_light()

    def open(self, host="127.0.0.1"):
        self.browser.console()
        self.browser.open(f"http://{host}:{self.pages_port}/?daemon=http://127.0.0.1:{self.port}")
        self.wait_until(lambda: self.browser.run("return Boolean(window.sphere)"), "the page has run")

    def wait_until(self, condition, what, seconds=60):
        try:
            return web.wait_until(condition, seconds * PATIENCE, what)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.browser.console()}") from None

    def open_lit(self):
        self.open()
        self.assertIsNone(self.browser.run("return sphere.fault ?? null"))
        self.wait_until(lambda: self.take()["time_ns"] is not None, "the light has come")

    @staticmethod
    def views():
        """From eight sides, none of them along an axis."""
        return [unit(x * 1.1, y * .8, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]

    def pixels(self):
        """25 of each view, which are 200 normals."""
        size = self.browser.run("return sphere.SIZE")
        return [(round(size * (.5 + .31 * i / 2)), round(size * (.5 + .31 * j / 2)))
                for i in range(-2, 3) for j in range(-2, 3)]

    def normals(self):
        """Of the sphere at these pixels: an orthographic camera looks at its middle with y up."""
        size, out = self.browser.run("return sphere.SIZE"), []
        for back in self.views():
            right = unit(back[2], 0, -back[0])
            up = (back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2],
                  back[0] * right[1] - back[1] * right[0])
            for column, row in self.pixels():
                x, y = 2 * (column + .5) / size - 1, 2 * (row + .5) / size - 1
                z = math.sqrt(1 - x * x - y * y)
                out.append(tuple(x * r + y * u + z * b for r, u, b in zip(right, up, back)))
        return out

    def take(self):
        """What the sphere sends, and of when the light is."""
        return self.browser.run("return sphere.take(arguments[0], arguments[1])", self.views(), self.pixels())

    def sphere_and_light(self):
        """(found, expected): colours at the normals, in the service's units."""
        with Watch(self) as lights:
            def both():
                taken = self.take()
                return taken["time_ns"] in lights and (taken["seen"], lights[taken["time_ns"]])
            seen, light = self.wait_until(both, "a light that the test has seen, too")
        scale = self.browser.run("return sphere.SCALE")
        found = [[c / scale for c in pixel] for view in seen for pixel in view]
        return found, [sent_by_white_in_all_light(light, n) for n in self.normals()]

    def check_sphere(self, what):
        found, expected = self.sphere_and_light()
        self.assertEqual(len(found), 200)
        worst, mean = differences(found, expected)
        print(f"three.js r{self.browser.run('return sphere.revision')}, {what}: {worst:.2%} off at most, {mean:.3%} "
              f"on average; {min(map(min, expected)):.0f} to {max(map(max, expected)):.0f}")
        self.assertLess(worst, .02, what)
        return found

    def shoot(self, name):
        if folder := os.environ.get("PENUMBRA_SCREENSHOTS"):
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.browser.run("sphere.show([0.4, 0.3, 1])")
            self.browser.screenshot(Path(folder) / f"{name}.png")

    def test_sphere_follows_the_light(self):
        self.open_lit()
        morning = self.check_sphere("morning")
        self.shoot("sphere-morning")
        kinds = self.browser.run("return sphere.inScene()")
        self.assertEqual((kinds.count("LightProbe"), kinds.count("DirectionalLight")),
                         (1, len(self.light()["lights"])))
        self.assertGreater(kinds.count("DirectionalLight"), 0)
        self.begin_anew(EVENING)
        self.addCleanup(self.begin_anew, MORNING)
        # Chromium asks again some seconds after a stream has broken.
        self.wait_until(lambda: self.is_lit_anew(morning), "the page finds the daemon again", 60)
        evening = self.check_sphere("evening")
        self.shoot("sphere-evening")
        self.assertGreater(differences(evening, morning)[1], .1)
        self.browser.run("sphere.close()")
        self.assertEqual(self.browser.run("return sphere.inScene()"), ["Mesh"])
        self.assertEqual(max(c for view in self.take()["seen"] for pixel in view for c in pixel), 0)

    def is_lit_anew(self, before):
        scale = self.browser.run("return sphere.SCALE")
        now = [[c / scale for c in pixel] for view in self.take()["seen"] for pixel in view]
        return differences(now, before)[1] > .1

    @classmethod
    def begin_anew(cls, room):
        """The same daemon on the same port in another room."""
        cls.finish()
        write_room(cls.root / "room.hdr", room)
        cls.lines.clear()
        cls.start()
        cls.wait_for_light()

    def test_wrong_signs_are_seen(self):
        """By hand in place of the client: three.js's own coefficients fit, Godot's do not."""
        self.open_lit()
        self.browser.run("sphere.close()")
        off = {}
        for name in ("three", "godot"):
            self.browser.run("sphere.clear()")
            with Watch(self) as lights:
                def taken():
                    self.browser.run("sphere.clear(); return sphere.takeAs(arguments[0])", name)
                    return self.browser.run("return sphere.take([], []).time_ns") in lights
                self.wait_until(taken, "a light that the test has seen, too")
            found = self.take()
            scale = self.browser.run("return sphere.SCALE")
            colours = [[c / scale for c in pixel] for view in found["seen"] for pixel in view]
            expected = [sent_by_white_in_all_light(lights[found["time_ns"]], n) for n in self.normals()]
            off[name] = differences(colours, expected)
            print(f"as={name} in three.js: {off[name][0]:.2%} off at most, {off[name][1]:.2%} on average")
        self.assertLess(off["three"][0], .02)
        self.assertGreater(off["godot"][0], .1)

    def test_a_page_that_is_not_listed_reads_nothing(self):
        self.open("localhost")  # the same page, but another origin
        self.assertIn("penumbra_three.js", self.browser.run("return sphere.fault ?? null") or "")
        told = self.browser.run("return fetch(arguments[0]).then(() => 'read', (error) => error.name)",
                                f"http://127.0.0.1:{self.port}/v1/light")
        self.assertEqual(told, "TypeError")
        self.open()
        told = self.browser.run("return fetch(arguments[0]).then(() => 'read', (error) => error.name)",
                                f"http://127.0.0.1:{self.port}/v1/light")
        self.assertEqual(told, "read")


# ---- Programs on the same machine. ----

def client_library():
    named = os.environ.get("PENUMBRA_CLIENT_LIBRARY")
    build = Path(program()).parents[1]
    return Path(named) if named else build / "service" / "client" / "libpenumbra_client.so.0"


def cube_texels(cube):
    """(solid angle, colour) of each; their directions do not matter for a mean."""
    numbers = struct.unpack(f"<{6 * 64 * 64 * 4}e", bytes(cube.texels))
    for at in range(6 * 64 * 64):
        s, t = (at % 64 + .5) / 32 - 1, (at // 64 % 64 + .5) / 32 - 1
        yield (1 + s * s + t * t) ** -1.5 / 32 ** 2, numbers[4 * at:4 * at + 3]


class Clients(Shared):
    """The page in memory by the Python client and by the examples, beside HTTP."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        os.environ["PENUMBRA_CLIENT_LIBRARY"] = str(client_library())
        sys.path.insert(0, str(CLIENT))
        cls.module = importlib.import_module("penumbra_client")
        cls.addClassCleanup(sys.path.remove, str(CLIENT))
        cls.wait_for_objects()

    def setUp(self):
        self.client = self.module.Client(self.root / "page")
        self.addCleanup(self.client.close)

    def wait(self, after=0):
        light = self.client.wait(after, int(20000 * PATIENCE))
        self.assertIsNotNone(light, "no light came")
        return light

    def test_lights_are_those_of_http(self):
        light, page = self.of_one_time(self.client.light, lambda found: found.capture_time_ns)
        self.assertFalse(page.stale)
        self.assertEqual((page.valid, page.bands, page.light_count), (1, light["bands"], len(light["lights"])))
        for rows, ours in ((page.coefficients, light["coefficients"]),
                           (page.residual, light["residual"]["coefficients"])):
            size = max(abs(c) for c in ours[0])
            self.assertGreater(len(ours), 1)
            for found, expected in zip(rows, ours):
                for a, b in zip(found, expected):
                    self.assert_close(a, b, 1e-5 * max(abs(b), 1e-3 * size))
        self.assertGreater(page.light_count, 0)
        for found, expected in zip(page.lights, light["lights"]):
            self.assertEqual(found.id, expected["id"] & 0xffffffff)
            for a, b in zip((*found.direction, *found.radiance, found.solid_angle_sr),
                            (*expected["direction"], *expected["radiance"], expected["solid_angle_sr"])):
                self.assert_close(a, b, 1e-5 * max(abs(b), 1e-2))
        for a, b in zip(page.mean_radiance, light["mean_radiance"]):
            self.assert_close(a, b, 1e-5 * b)

    def test_numbers_rise(self):
        lights = [self.wait()]
        for _ in range(10):
            lights.append(self.wait(lights[-1].number))
        for before, after in zip(lights, lights[1:]):
            self.assertGreater(after.number, before.number)
            self.assertGreater(after.capture_time_ns, before.capture_time_ns)
            self.assertGreaterEqual(after.published_ns, before.published_ns)

    def test_objects_stand_where_http_says(self):
        answer = self.ask("PATCH", "/v1/objects/box", {"position_m": [.3, 0, -.2], "turn_deg": 40})
        self.assertEqual(answer.status, 200, answer.body)
        self.wait_for("the move", lambda: abs(self.client.objects().objects[0].position_m[0] - .3) < 1e-6)
        ours = self.ask("GET", "/v1/objects").json()["objects"][0]
        objects = self.client.objects()
        self.assertEqual((objects.count, objects.objects[0].name), (1, b"box"))
        found = objects.objects[0]
        for a, b in zip(found.position_m, ours["position_m"]):
            self.assert_close(a, b, 1e-6)
        half = math.radians(ours["turn_deg"]) / 2
        self.assert_close(math.degrees(half), 20, 1e-6)
        turn = [math.cos(half), *(math.sin(half) * n for n in ours["normal"])]
        sign = math.copysign(1, dot(turn, found.rotation_wxyz))  # both signs are the same rotation
        for a, b in zip(found.rotation_wxyz, turn):
            self.assert_close(sign * a, b, 1e-6)
        self.assertEqual(found.visible, 1)
        number = objects.number
        self.ask("PATCH", "/v1/objects/box", {"visible": False})
        self.wait_for("it to go", lambda: self.client.objects().objects[0].visible == 0)
        self.assertGreater(self.client.objects().number, number)
        self.ask("PATCH", "/v1/objects/box", {"visible": True, "position_m": [0, 0, 0], "turn_deg": 0})

    def test_cube_has_the_light_of_the_room(self):
        self.wait_for("a cube", lambda: self.client.cube() is not None)
        cube, light = self.client.cube(), self.wait()
        self.assertEqual((cube.size, cube.faces), (64, 6))
        texels = list(cube_texels(cube))
        whole = sum(angle for angle, _ in texels)
        self.assert_close(whole, 4 * math.pi, 1e-3)
        for c in range(3):
            mean = sum(angle * colour[c] for angle, colour in texels) / whole
            print(f"mean radiance {'RGB'[c]}: {mean:.3f} by the cube, {light.mean_radiance[c]:.3f} by the light")
            self.assert_close(mean, light.mean_radiance[c], .02 * light.mean_radiance[c])

    def check_example(self, command, environment):
        """It prints lights, which are those of HTTP."""
        with subprocess.Popen([*map(str, command), str(self.root / "page")], env=dict(os.environ, **environment),
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as example:
            try:
                lines = [example.stdout.readline() for _ in range(12)]
            finally:
                example.terminate()
            said = example.stderr.read()
        heads = [re.fullmatch(r"light (\d+), (\d+\.\d) ms old, mean radiance ([\d.]+) ([\d.]+) ([\d.]+)\n", line)
                 for line in lines]
        numbers = [int(head[1]) for head in heads if head]
        self.assertGreater(len(numbers), 1, f"{lines}\n{said}")
        self.assertEqual(numbers, sorted(set(numbers)))
        ours = self.light()
        for found, mean in zip(heads[0].groups()[2:], ours["mean_radiance"]):
            self.assert_close(float(found), mean, .02 * mean)
        towards = re.match(r"  light (\d+) towards (\S+) (\S+) (\S+)", lines[1])
        self.assertTrue(towards, lines)
        found = next(light for light in ours["lights"] if light["id"] == int(towards[1]))
        for a, b in zip(towards.groups()[1:], found["direction"]):
            self.assert_close(float(a), b, .02)

    def test_c_example_prints_lights(self):
        installed = self.root / "include" / "penumbra" / "client"
        installed.mkdir(parents=True)
        for header in CLIENT.glob("*.h"):
            shutil.copy(header, installed)
        built = subprocess.run([os.environ.get("CC", "cc"), "-std=c11", "-Wall", "-Wextra", "-Werror",
                                "-I", self.root / "include", EXAMPLES / "client_light.c", client_library(),
                                "-o", self.root / "client_light"], capture_output=True, text=True, check=False)
        self.assertEqual(built.returncode, 0, built.stderr)
        self.check_example([self.root / "client_light"], {"LD_LIBRARY_PATH": str(client_library().parent)})

    def test_python_example_prints_lights(self):
        self.check_example([sys.executable, "-u", EXAMPLES / "client_light.py"], {"PYTHONPATH": str(CLIENT)})

    def test_latency_is_told(self):
        """From a picture to the client; told, not judged. The studio's pictures have a clock whose zero nobody tells,
        so that of the whole way only what is above the quickest light is known, and the stages beside it."""
        from_page, from_picture, number = [], [], self.wait().number
        for _ in range(100):
            light = self.wait(number)
            now, number = time.monotonic_ns(), light.number
            from_page.append((now - light.published_ns) * 1e-6)
            from_picture.append((now - light.capture_time_ns) * 1e-6)
        least = min(from_picture)
        stages = self.ask("GET", "/v1/stages").json()["stages"]
        work = sum(stages[name]["p50_ms"] for name in ("source", "merge", "assemble", "light"))
        print(f"from the page to the client: {statistics.median(from_page):.2f} ms median, {max(from_page):.2f} ms at "
              f"most; stages before: {work:.1f} ms by their medians; from the picture to the client, above the "
              f"quickest: {statistics.median(from_picture) - least:.1f} ms median, {max(from_picture) - least:.1f} ms "
              "at most")
        self.assertGreaterEqual(min(from_page), 0)


if __name__ == "__main__":
    sys.exit(main(__name__))
