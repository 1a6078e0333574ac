#!/usr/bin/env python3
"""Compares dashboard, alerts and page with the metrics that the code has: monitoring_test.py ROOT

Names are compared by themselves. promtool checks the queries and runs alerts_test.yml.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

ROOT = Path(__file__).parents[2]
METRIC = re.compile(r"\b(?:penumbra|process)_[a-z0-9_]+\b")
OF_HISTOGRAMS = ("_bucket", "_sum", "_count")


def text_of(path):
    return (ROOT / path).read_text(encoding="utf-8")


def metrics_of_code():
    """{name: type}"""
    code = text_of("service/http/metrics.cpp")
    found = dict(re.findall(r'm\.begin\("(\w+)",\s*"(\w+)"', code))
    return found | {name: kind for kind, name in re.findall(r'm\.(gauge|counter)\(\s*"(\w+)"', code)}


def queries_of_dashboard():
    board = json.loads(text_of("docs/examples/grafana.json"))
    return [target["expr"] for panel in board["panels"] for target in panel["targets"]]


def queries_of_alerts():
    """By name; a query stands on one line, or folded over several that are indented deeper."""
    text = re.sub(r"(?m)^ *#.*\n", "", text_of("docs/examples/alerts.yml"))
    return dict(re.findall(r"- alert: (\w+)\n +expr: (?:>-\n)?(.*?)\n +for:", text, re.DOTALL))


def unknown_metrics(query, metrics):
    names = set(METRIC.findall(re.sub(r'"[^"]*"', "", query)))
    parts = {name + end for name, kind in metrics.items() if kind == "histogram" for end in OF_HISTOGRAMS}
    return names - set(metrics) - parts


def promtool(test, *arguments):
    if not shutil.which("promtool"):
        test.skipTest("promtool is not installed")
    done = subprocess.run(["promtool", *map(str, arguments)], capture_output=True, text=True, timeout=60, check=False)
    test.assertEqual(done.returncode, 0, done.stdout + done.stderr)
    return done.stdout


class Names(unittest.TestCase):
    def setUp(self):
        self.metrics = metrics_of_code()
        self.assertGreater(len(self.metrics), 20)

    def test_unknown_names_are_seen(self):
        query = 'penumbra_streams + penumbra_no{a="penumbra_b"}'
        self.assertEqual(unknown_metrics(query, self.metrics), {"penumbra_no"})
        self.assertEqual(unknown_metrics("rate(penumbra_stage_seconds_bucket[5m])", self.metrics), set())
        self.assertEqual(unknown_metrics("penumbra_streams_sum", self.metrics), {"penumbra_streams_sum"})

    def test_dashboard_and_alerts_ask_for_what_is_there(self):
        alerts = queries_of_alerts()
        self.assertEqual(len(alerts), text_of("docs/examples/alerts.yml").count("- alert:"))
        for query in [*queries_of_dashboard(), *alerts.values()]:
            self.assertEqual(unknown_metrics(query, self.metrics), set(), query)

    def test_the_page_has_each_metric_with_its_type(self):
        rows = re.findall(r"(?m)^\| `(\w+)` \| (gauge|counter|histogram) \|", text_of("docs/reference/http.md"))
        self.assertEqual(dict(rows), self.metrics)

    def test_each_alert_comes_in_a_test_and_stays_away_in_another(self):
        tests = text_of("tests/integration/alerts_test.yml")
        tested = re.findall(r"alertname: (\w+)[,\n].*?exp_alerts:(?: (\[\])|\n)", tests, re.DOTALL)
        for name in queries_of_alerts():
            self.assertEqual({empty for alert, empty in tested if alert == name}, {"", "[]"}, name)


class Queries(unittest.TestCase):
    def test_alerts_are_rules_that_come_when_they_should(self):
        promtool(self, "check", "rules", ROOT / "docs/examples/alerts.yml")
        promtool(self, "test", "rules", ROOT / "tests/integration/alerts_test.yml")

    def test_queries_of_the_dashboard_can_be_read(self):
        rules = [{"record": f"test:query:{i}", "expr": query.replace("$__rate_interval", "1m")}
                 for i, query in enumerate(queries_of_dashboard())]
        self.assertGreater(len(rules), 10)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "rules.yml"
            file.write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
            self.assertIn(f"{len(rules)} rules found", promtool(self, "check", "rules", file))


def main():
    global ROOT
    ROOT = Path(sys.argv[1]).resolve()
    result = unittest.main(argv=[sys.argv[0], *sys.argv[2:]], exit=False).result
    for _, reason in result.skipped:
        print(f"skipped: {reason}")
    if result.wasSuccessful() and result.skipped:
        return 77
    return 0 if result.wasSuccessful() else 1


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main())
