#!/usr/bin/env python3
"""Compares the daemon with docs/reference/openapi.json: openapi_test.py DAEMON [CLASS...]

Answers have to fit the file, bodies that the file refuses have to be refused, and the routes of service/http/ have to
be those of the file. Standard library only.
"""

import http.client
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
import unittest

import openapi_document as openapi
from cli_case import PATIENCE, main
from daemon_case import JSON, RIG, SCENE, STREAMS, TOKEN, Daemon, UnixConnection
from json_schema import Schemas

BEGINNINGS = {"image/jpeg": b"\xff\xd8\xff", "image/png": b"\x89PNG\r\n", "image/x-exr": b"\x76\x2f\x31\x01",
              "image/vnd.radiance": b"#?RADIANCE", "text/html": b"<!doctype html>"}


class Described(Daemon):
    """A daemon, and what the file says of it."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.document = openapi.read()
        cls.schemas = openapi.strict(cls.document)
        cls.operations = list(openapi.operations(cls.document))

    def operation(self, name):
        return next(o for o in self.operations if o.what["operationId"] == name)

    def check_answer(self, operation, answer, what=""):
        """Status, media type and body are of those that the operation has."""
        name = f"{operation} {what}: {answer.status} {answer.body[:200]}"
        responses = operation.what["responses"]
        self.assertIn(str(answer.status), responses, name)
        content = self.schemas.resolved(responses[str(answer.status)]).get("content", {})
        if "*/*" not in content:
            self.assertIn(answer.kind, content, name)
        schema = content.get(answer.kind, {}).get("schema", {})
        if answer.kind == "application/json":
            self.assertEqual(self.schemas.faults(answer.json(), schema), [], name)
        elif answer.status < 300:
            self.assertTrue(answer.kind in STREAMS or answer.body, name)
            self.assertTrue(answer.body.startswith(BEGINNINGS.get(answer.kind, b"")), name)

    def check_refusal(self, operation, answer, what):
        self.assertTrue(400 <= answer.status < 500, f"{operation} {what}: {answer.status} {answer.body}")
        self.check_answer(operation, answer, what)


class Checker(unittest.TestCase):
    """The checker of schemas on values that are right and wrong: one that sees nothing cannot pass."""

    def test_each_keyword_refuses_what_it_is_for(self):
        document = {"a": {"type": "object", "required": ["b"], "properties": {"b": {"type": "integer"}}}}
        for schema, right, wrong in (
                ({"type": "number"}, [1, 1.5], [True, None, "1", float("nan")]),
                ({"type": "integer"}, [1, 2.0], [1.5, True]),
                ({"type": ["string", "null"]}, ["", None], [1, False]),
                ({"enum": [1, "a"]}, [1, "a"], [True, "b"]), ({"const": True}, [True], [1, False]),
                ({"minimum": 0, "maximum": 2}, [0, 2], [-1e-9, 2.1]),
                ({"exclusiveMinimum": 0, "exclusiveMaximum": 2}, [.1, 1.9], [0, 2]),
                ({"minLength": 1, "maxLength": 2}, ["a", "ab"], ["", "abc"]), ({"pattern": "^a$"}, ["a"], ["b"]),
                ({"type": "array", "minItems": 1, "maxItems": 2, "items": {"type": "null"}}, [[None]],
                 [[], [None] * 3, [1]]),
                ({"oneOf": [{"type": "integer"}, {"minimum": 5}]}, [1, 5.5], [6, 1.5]),
                ({"anyOf": [{"type": "integer"}, {"minimum": 5}]}, [6, 5.5], [1.5]),
                ({"properties": {"a": {}}, "additionalProperties": False}, [{}, {"a": 1}], [{"b": 1}]),
                ({"additionalProperties": {"type": "null"}}, [{"a": None}], [{"a": 1}]),
                ({"$ref": "#/a"}, [{"b": 1}, {"b": 1, "c": 2}], [{}, {"b": "1"}, 1])):
            for value in right:
                self.assertEqual(Schemas(document).faults(value, schema), [], (schema, value))
            for value in wrong:
                self.assertTrue(Schemas(document).faults(value, schema), (schema, value))
        self.assertTrue(openapi.strict(document).faults({"b": 1, "c": 2}, {"$ref": "#/a"}))
        with self.assertRaises(ValueError):
            Schemas({}).faults(1, {"multipleOf": 2})

    def test_wrong_bodies_are_wrong_in_every_way(self):
        schema = {"type": "object", "required": ["a"], "additionalProperties": False,
                  "properties": {"a": {"type": "number", "maximum": 1}}}
        bodies = [json.dumps(body) for body in openapi.wrong_bodies(schema, {"a": 0}, Schemas({}))]
        for body in ({"a": 0, "no_such_key": 1}, {}, {"a": "text"}, {"a": True}, {"a": 1.001}, [], None):
            self.assertIn(json.dumps(body), bodies)
        self.assertNotIn(json.dumps({"a": 1}), bodies)


class Description(unittest.TestCase):
    """The file by itself, and beside the code."""

    def setUp(self):
        self.document = openapi.read()
        self.schemas = Schemas(self.document)
        self.operations = list(openapi.operations(self.document))

    def test_operations_are_named_and_said_in_words(self):
        names = [o.what["operationId"] for o in self.operations]
        self.assertEqual(sorted(names), sorted(set(names)))
        for o in self.operations:
            self.assertRegex(o.what.get("summary", ""), r"^[A-Z].*[^.]$", o)
            self.assertLessEqual({"401", "403"}, o.what["responses"].keys(), o)
            in_path = {p["name"] for p in o.parameters if p["in"] == "path" and p["required"]}
            self.assertEqual(in_path, set(re.findall(r"\{(\w+)\}", o.path)), o)
            for parameter in o.parameters:
                self.assertEqual(self.schemas.faults(parameter["example"], parameter["schema"]), [], o)
            for status, response in o.what["responses"].items():
                self.assertTrue(self.schemas.resolved(response).get("description"), f"{o} {status}")

    def test_components_are_used_and_there(self):
        used = set(openapi.all_references(self.document))
        for reference in used:
            self.schemas.at(reference)
        components = self.document["components"]
        known = {f"#/components/{kind}/{name}" for kind in components if kind != "securitySchemes"
                 for name in components[kind]}
        self.assertEqual(known - used, set())
        named = {name for one in self.document["security"] for name in one}
        self.assertEqual(named, set(components["securitySchemes"]))

    def test_examples_fit(self):
        for name, schema in self.document["components"]["schemas"].items():
            for example in schema.get("examples", []):
                self.assertEqual(self.schemas.faults(example, schema), [], name)
        for o in self.operations:
            if o.body() is not None:
                self.assertTrue(openapi.examples_of(o.body(), self.schemas), f"{o} has no example")
                for example in openapi.examples_of(o.body(), self.schemas):
                    self.assertEqual(self.schemas.faults(example, o.body()["schema"]), [], o)

    def test_routes_are_those_of_the_code(self):
        self.assertEqual({str(o) for o in self.operations}, routes_of_code())


def routes_of_code():
    """'GET /v1/light' and so on, as the sources add them."""
    route = re.compile(r'server\.(Get|Post|Put|Patch|Delete|Options)\(\s*(?:R"\((.*?)\)"|"(.*?)")\s*,')
    out, folder = set(), openapi.ROOT / "service" / "http"
    for path in sorted(folder.glob("*.cpp")):
        text = path.read_text(encoding="utf-8")
        found = route.findall(text)
        for method, raw, plain in found:
            out |= {f"{method.upper()} {address}" for address in addresses(raw or plain)}
        others = len(re.findall(r"server\.(?:Get|Post|Put|Patch|Delete|Options)\(", text)) - len(found)
        # The page's files are added in a loop over what is built in.
        if others != (1 if path.name == "page_routes.cpp" else 0):
            raise AssertionError(f"{path}: {others} routes that this test cannot read")
    built_in = re.search(r"set\(files ([^)]*)\)", (folder / "CMakeLists.txt").read_text(encoding="utf-8"))
    names = [file.rpartition("/")[2] for file in built_in[1].split()] + ["openapi.json"]
    return out | {"GET /" + ("" if name == "index.html" else name) for name in names}


def addresses(pattern):
    """The addresses of a route's pattern: a choice gives several, (.+) is a name and (\\d+) a number."""
    pattern = pattern.replace("(.+)", "{name}").replace(r"(\d+)", "{number}")
    choice = re.search(r"\(([^)]*)\)(\??)", pattern)
    if not choice:
        return [pattern]
    ends = choice[1].replace("\\", "").split("|") + ([""] if choice[2] else [])
    return [pattern[:choice.start()] + end + pattern[choice.end():] for end in ends]


class Answers(Described):
    """What is read."""

    def test_reads_answer_as_described(self):
        reads = [o for o in self.operations if o.method == "GET"]
        for operation in reads:  # some of them have nothing yet
            self.check_answer(operation, self.ask("GET", operation.address()), "at the start")
        self.wait_for_objects()
        self.ask("GET", "/v1/environment.exr")
        for operation in reads:
            queries = [{}] + [{p["name"]: value} for p in operation.queries()
                              for value in self.schemas.resolved(p["schema"]).get("enum", [p["example"]])]
            for query in queries:
                answer = self.ask("GET", operation.address(**query))
                self.assertEqual(answer.status, 200, f"{operation} {query}")
                self.check_answer(operation, answer, query)

    def test_parameters_are_held_to_their_schemas(self):
        self.wait_for("light", lambda: self.ask("GET", "/v1/light").status == 200)
        tried = 0
        for operation in self.operations:
            for parameter in operation.queries():
                for value in ("", "text", 0, -1, 1e9):
                    if self.schemas.faults(value, parameter["schema"]):
                        tried += 1
                        answer = self.ask(operation.method, operation.address(**{parameter["name"]: value}))
                        self.check_refusal(operation, answer, f"{parameter['name']}={value}")
        self.assertGreater(tried, 10)

    def test_events_bring_the_state(self):
        operation = self.operation("streamEvents")
        schema = operation.what["responses"]["200"]["content"]["text/event-stream"]["schema"]["contentSchema"]
        connection = self.connection()
        self.addCleanup(connection.close)
        connection.request("GET", operation.address(rate_hz=20))
        reply = connection.getresponse()
        self.assertEqual((reply.status, reply.headers.get_content_type()), (200, "text/event-stream"))
        frames = []
        for _ in range(3):
            self.assertEqual(reply.readline(), b"event: state\n")
            data = reply.readline()
            self.assertEqual((data[:6], reply.readline()), (b"data: ", b"\n"))
            state = json.loads(data[6:])
            self.assertEqual(self.schemas.faults(state, schema), [])
            frames.append(state["frames"])
        self.assertEqual(frames, sorted(frames))

    def test_motion_jpeg_brings_one_frame_after_the_other(self):
        self.wait_for("a frame", lambda: self.ask("GET", "/v1/frame.jpg").status == 200)
        connection = self.connection()
        self.addCleanup(connection.close)
        connection.request("GET", "/v1/frame.mjpeg?rate_hz=20")
        reply = connection.getresponse()
        boundary = reply.headers.get_param("boundary")
        times = []
        for _ in range(3):
            self.assertEqual(reply.readline().decode(), f"--{boundary}\r\n")
            head = http.client.parse_headers(reply)
            self.assertEqual(head["Content-Type"], "image/jpeg")
            body = reply.read(int(head["Content-Length"]))
            self.assertEqual((body[:3], body[-2:], reply.readline()), (b"\xff\xd8\xff", b"\xff\xd9", b"\r\n"))
            times.append(float(head["X-Timestamp"]))
        self.assertEqual(times, sorted(set(times)))

    def test_the_description_is_served(self):
        self.assertEqual(self.ask("GET", "/openapi.json").body, openapi.FILE.read_bytes())

    def test_the_socket_answers_alike(self):
        path = self.root / "run" / "penumbra" / "http.sock"
        self.assertEqual(path.stat().st_mode & 0o777, 0o600)
        operation = self.operation("getState")
        self.check_answer(operation, self.ask("GET", "/v1/state", connection=UnixConnection(path)))
        host = {"Host": "elsewhere.example"}  # who may open the socket may ask
        self.assertEqual(self.ask("GET", "/v1/state", headers=host, connection=UnixConnection(path)).status, 200)

    def test_what_is_not_described_is_not_answered(self):
        described = {(o.method, o.path) for o in self.operations}
        error = self.document["components"]["schemas"]["Error"]
        for operation in {o.path: o for o in self.operations}.values():
            for method in ("PUT", "POST", "PATCH", "DELETE"):
                if (method, operation.path) in described:
                    continue
                answer = self.ask(method, operation.address(), b"{}" if method != "DELETE" else None, JSON)
                self.assertEqual(answer.status, 405, f"{method} {operation.path}")
                self.assertEqual({one for one in answer.headers["Allow"].split(", ") if one != "HEAD"},
                                 {one.method for one in self.operations if one.path == operation.path})
                self.assertEqual(self.schemas.faults(answer.json(), error), [])
        for path in ("/v2", "/v1", "/v1/", "/v1/lights", "/v1/frame", "/v1/environment.png", "/v1/light/..%2f..%2fetc",
                     "/page.html", "//", "/v1/objects/", "/" + "x" * 3000):
            for method in ("GET", "DELETE"):
                answer = self.ask(method, path)
                self.assertEqual(answer.status, 404, path)
                self.assertNotIn("Allow", answer.headers)
                self.assertEqual(self.schemas.faults(answer.json(), error), [])
        for path, allowed in (("/v1/objects/box", "DELETE, PATCH"), ("/v1/lamps/0", "DELETE, PATCH")):
            answer = self.ask("GET", path)
            self.assertEqual((answer.status, answer.headers["Allow"]), (405, allowed))

    def test_foreign_hosts_are_refused(self):
        for operation in self.operations:
            answer = self.ask(operation.method, operation.address(), headers={"Host": "elsewhere.example"})
            self.assertEqual(answer.status, 403, str(operation))
            self.check_answer(operation, answer)

    def test_prometheus_reads_the_metrics(self):
        if not shutil.which("promtool"):
            self.skipTest("promtool is not installed")
        done = subprocess.run(["promtool", "check", "metrics"], input=self.ask("GET", "/metrics").body,
                              capture_output=True, timeout=60, check=False)
        self.assertEqual((done.returncode, done.stdout, done.stderr), (0, b"", b""))


class Changes(Described):
    """What is changed."""

    def state(self):
        """All that requests change."""
        state = self.ask("GET", "/v1/state").json()
        out = {key: state[key] for key in ("objects", "budget", "recording", "preparing", "faults")}
        return out | {"lamps": self.ask("GET", "/v1/scene").json()["lamps"]}

    def good_answer(self, name, body=None, **headers):
        operation = self.operation(name)
        answer = self.ask(operation.method, operation.address(), body, headers)
        self.assertIn(answer.status, (200, 201, 202), f"{operation} {body}: {answer.body}")
        self.check_answer(operation, answer, body)
        return answer.json()

    def wait_until_quiet(self):
        """Until nothing is baked any more."""
        self.wait_for_objects()
        before = [None]
        cache = os.path.join(self.environment["XDG_CACHE_HOME"], "penumbra")

        def same():
            known = os.listdir(cache) if os.path.isdir(cache) else []
            now = (self.state(), sorted(known), "".join(self.lines))
            last, before[0] = before[0], now
            return last == now and not now[0]["preparing"]
        self.wait_for("rest", same)

    def test_1_wrong_bodies_are_refused_and_change_nothing(self):
        self.wait_for_objects()  # a bake that has not begun is quiet, too
        self.wait_until_quiet()
        before, tried = self.state(), 0
        for operation in self.operations:
            body = operation.body()
            if body is None:
                continue
            schema = body["schema"]
            good = dict(openapi.examples_of(body, self.schemas)[0])
            for wrong in openapi.wrong_bodies(schema, good, self.schemas):
                self.check_refusal(operation, self.ask(operation.method, operation.address(), wrong), wrong)
                tried += 1
            for text in (b"", b"{", b"{'a': 1}", b"\xff\xfe", b'{"a": 1e999}') if schema else ():
                answer = self.ask(operation.method, operation.address(), text, JSON)
                self.check_refusal(operation, answer, text)
            for headers in ({}, {"Content-Type": "text/plain"}, {"Content-Type": "application/x-www-form-urlencoded"}):
                answer = self.ask(operation.method, operation.address(), json.dumps(good).encode(), headers)
                self.assertEqual(answer.status, 415, f"{operation} {headers}")
                self.check_refusal(operation, answer, headers)
            answer = self.ask(operation.method, operation.address(), b" " * 70_000, JSON)
            self.assertEqual(answer.status, 413, str(operation))
            self.check_refusal(operation, answer, "a large body")
        self.assertGreater(tried, 100)
        self.assertEqual(self.state(), before)

    def test_2_good_bodies_are_taken(self):
        self.wait_for_objects()
        for name in ("changeObject", "changeBudget", "setExposures"):
            operation = self.operation(name)
            for example in openapi.examples_of(operation.body(), self.schemas):
                self.good_answer(name, example)
        change = {"position_m": [.1, 0, .2], "turn_deg": 45, "visible": True}
        box = self.good_answer("changeObject", change)["objects"][0]
        self.assertEqual((box["name"], box["position_m"], box["visible"]), ("box", [.1, 0, .2], True))
        self.assert_close(box["turn_deg"], 45, 1e-9)
        self.assertEqual(self.good_answer("changeBudget", {"max_shadow_error": .25}), {"max_shadow_error": .25})
        self.assertEqual(self.state()["budget"], {"max_shadow_error": .25})

    def test_2_exposures_are_those_that_were_asked_for(self):
        self.wait_for("light", lambda: self.ask("GET", "/v1/light").status == 200)
        age = lambda: self.ask("GET", "/v1/light").json()["age_s"]  # noqa: E731
        self.wait_for("fresh light", lambda: age() < 1)
        asked = {"exposures_s": [60.0], "gains": [1.0]}
        self.assertEqual(self.good_answer("setExposures", asked), {"camera": "environment"} | asked)
        self.wait_for("an old light", lambda: age() > 2)  # white pictures are none
        self.assertEqual(self.good_answer("resetExposures"), {"camera": "environment"})
        self.wait_for("fresh light again", lambda: age() < 1)
        operation = self.operation("setExposures")
        for camera, body, status in (("nobody", asked, 404), ("view", {"exposures_s": [.1, .2]}, 400),
                                     ("view", asked, 400), ("environment", {"exposures_s": [.1], "gains": [1, 2]}, 400)):
            answer = self.ask("PUT", f"/v1/cameras/{camera}/exposures", body)
            self.assertEqual(answer.status, status, camera)
            self.check_refusal(operation, answer, body)

    def test_3_files_are_written(self):
        self.wait_for("a frame", lambda: self.ask("GET", "/v1/frame.jpg").status == 200)
        for example in ({}, {"file": "take_1.mkv"}, {"file": "take_2.mkv", "light": "track"}):
            name = self.good_answer("startRecording", example)["file"]
            start = self.operation("startRecording")
            self.check_answer(start, self.ask("POST", start.path, {}), "a second one")
            self.wait_for("a frame", lambda: self.state()["recording"]["frames"] > 0)
            done = self.good_answer("stopRecording")
            self.assertEqual((done["file"], done["active"]), (name, False))
            self.assertEqual((self.root / "recordings" / name).read_bytes()[:4], b"\x1a\x45\xdf\xa3")
        stop = self.operation("stopRecording")
        self.assertEqual(self.ask("DELETE", stop.path).status, 404)
        again = self.ask("POST", start.path, {"file": "take_1.mkv"})
        self.assertEqual(again.status, 400)
        self.check_refusal(start, again, "a file that is there")
        name = self.good_answer("takeSnapshot", {})["file"]
        self.assertTrue((self.root / "recordings" / name).read_bytes().startswith(BEGINNINGS["image/png"]))

    def test_4_objects_come_and_go(self):
        self.wait_for_objects()
        add = self.operation("addObject")
        example = openapi.examples_of(add.body(), self.schemas)[0]
        self.assertEqual(self.good_answer("addObject", example), {"preparing": example["name"]})
        self.check_refusal(add, self.ask("POST", add.path, example), "a name that is taken")
        self.assertEqual(self.ask("POST", add.path, {"name": "b", "asset": "none.obj"}).status, 404)
        self.wait_for("the ball", lambda: len(self.state()["objects"]) == 2)
        self.assertEqual(self.good_answer("removeObject"), {"removed": "box"})
        self.wait_for("the end of the box", lambda: [o["name"] for o in self.state()["objects"]] == [example["name"]])
        for name in ("removeObject", "changeObject"):
            gone = self.operation(name)
            answer = self.ask(gone.method, gone.address(), {} if gone.body() else None)
            self.assertEqual(answer.status, 404)
            self.check_refusal(gone, answer, "the box")

    def test_5_lamps_come_and_go(self):
        self.wait_for_objects()
        example = openapi.examples_of(self.operation("addLamp").body(), self.schemas)[0]
        self.assertEqual(self.good_answer("addLamp", example)["lamps"], [example])
        changed = self.good_answer("changeLamp", {"radius_m": .25})["lamps"]
        self.assertEqual(changed, [example | {"radius_m": .25}])
        self.assertEqual(self.state()["lamps"], changed)
        self.assertEqual(self.good_answer("removeLamp")["lamps"], [])
        for name in ("changeLamp", "removeLamp"):
            gone = self.operation(name)
            answer = self.ask(gone.method, gone.address(), {} if gone.body() else None)
            self.assertEqual(answer.status, 404)
            self.check_refusal(gone, answer, "a lamp that is gone")

    def test_6_another_scene_is_shown(self):
        self.wait_for("a start", lambda: self.ask("GET", "/v1/objects").status == 200)
        (self.root / "other.toml").write_text(SCENE.replace('"box"', '"crate"', 1))
        self.good_answer("showScene", {"file": "other.toml"})
        self.wait_for("the crate", lambda: [o["name"] for o in self.state()["objects"]] == ["crate"])
        self.assertEqual(self.ask("PUT", "/v1/scene", {"file": "none.toml"}).status, 404)
        (self.root / "broken.toml").write_text("version = ")
        broken = self.ask("PUT", "/v1/scene", {"file": "broken.toml"})
        self.assertEqual(broken.status, 400)
        self.check_refusal(self.operation("showScene"), broken, "a broken file")


class Access(Described):
    """With a token."""

    rig = RIG + 'token_file = "token"\norigins = ["https://app.example"]\n'

    def test_the_token_is_asked_for_in_each_way(self):
        schemes = self.document["components"]["securitySchemes"]
        cookie = schemes["cookie"]["name"].replace("8787", str(self.port))
        query = schemes["address"]["name"]
        self.assertEqual(schemes["bearer"]["scheme"], "bearer")
        for operation in self.operations:
            for headers in ({}, {"Authorization": "Bearer " + TOKEN[:-1]}, {"Cookie": f"{cookie}={TOKEN}0"}):
                answer = self.ask(operation.method, operation.address(), headers=headers)
                self.assertEqual((answer.status, answer.headers.get("WWW-Authenticate")), (401, "Bearer"), operation)
                self.check_answer(operation, answer)
        host = {"Host": "rig.example"}
        self.assertEqual(self.ask("GET", "/v1/state", headers={"Authorization": f"Bearer {TOKEN}", **host}).status, 200)
        first = self.ask("GET", f"/v1/state?{query}={TOKEN}", headers=host)
        self.assertEqual(first.status, 200)
        self.assertTrue(first.headers["Set-Cookie"].startswith(f"{cookie}={TOKEN}; HttpOnly; SameSite=Strict"))
        again = self.ask("GET", "/v1/state", headers={"Cookie": f"a=b; {cookie}={TOKEN}", **host})
        self.assertEqual(again.status, 200)
        path = self.root / "run" / "penumbra" / "http.sock"
        self.assertEqual(self.ask("GET", "/v1/state", connection=UnixConnection(path)).status, 200)

    def test_listed_origins_may_read(self):
        for origin, allowed in (("https://app.example", "https://app.example"), ("https://other.example", None)):
            asked = self.ask("OPTIONS", "/v1/budget", headers={"Origin": origin})
            self.assertEqual((asked.status, asked.headers.get("Access-Control-Allow-Origin")), (204, allowed))
            headers = {"Origin": origin, "Authorization": f"Bearer {TOKEN}"}
            answer = self.ask("GET", "/v1/state", headers=headers)
            self.assertEqual(answer.headers.get("Access-Control-Allow-Origin"), allowed)


class Protocol(Described):
    """What HTTP itself asks for (RFC 9110), whatever is asked."""

    def test_ranges_are_not_looked_at(self):
        self.wait_for("light", lambda: self.ask("GET", "/v1/light").status == 200)
        for path, status in (("/v1/frame.jpg", 200), ("/page.js", 200), ("/v1/light", 200), ("/v1/nothing", 404)):
            for ranges in ("bytes=0-3", "bytes=0-3,5-9", "bytes=99999999-"):
                answer = self.ask("GET", path, headers={"Range": ranges})
                self.assertEqual((answer.status, "Content-Range" in answer.headers), (status, False), path)
                self.assertGreater(len(answer.body), 10, path)

    def test_a_request_without_a_body_says_no_length(self):
        for method, path, status in (("POST", "/v1/light", 411), ("PUT", "/v1/state", 411),
                                     ("POST", "/v1/snapshot", 411), ("DELETE", "/v1/recording", 404)):
            started = time.monotonic()
            with socket.create_connection(("127.0.0.1", self.port), timeout=20) as connection:
                connection.sendall(f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
                line = connection.recv(100).split(b"\r\n")[0].decode()
            self.assertEqual(line.split()[1], str(status), f"{method} {path}")
            self.assertLess(time.monotonic() - started, 3 * PATIENCE, f"{method} {path}")

    def test_a_slow_rate_is_no_fast_one(self):
        connection = self.connection()
        self.addCleanup(connection.close)
        connection.request("GET", "/v1/events?rate_hz=1e-300")
        reply = connection.getresponse()
        if reply.status == 400:
            return
        reply.readline()
        connection.sock.settimeout(2)
        try:
            text = reply.read(20_000)
        except TimeoutError:
            return
        self.fail(f"{text.count(b'event: state')} events at once")


if __name__ == "__main__":
    sys.exit(main(__name__))
