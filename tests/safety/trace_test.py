#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Self-test of trace.py: every way in which it must fail, and the one in which it must not."""
import contextlib
import io
import pathlib
import tempfile
import unittest

import trace

REQUIREMENTS = """
| Id | Requirement | Bound | Hazards | Verified in |
|---|---|---|---|---|
| SR-01 | The gate shall refuse. | now | H-01 | tests/safety |
| SR-02 | The client shall refuse. | now | H-01 | tests/bridge |
"""
HAZARDS = "| H-01 | Burn | S3 | somehow | SR-01, SR-02 |\n"
TAG = '<properties><property name="requirement" value="{}"/></properties>'


def case(name, inner="", status="run"):
    return f'<testcase name="{name}" classname="Gate" status="{status}">{inner}</testcase>'


BOTH = [case("A", TAG.format("SR-01")), case("B", TAG.format("SR-02"))]


class TraceTest(unittest.TestCase):
    def run_trace(self, cases, requirements=REQUIREMENTS, hazards=HAZARDS, xml=None):
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            (folder / "requirements.md").write_text(requirements)
            (folder / "hazards.md").write_text(hazards)
            (folder / "xml").mkdir()
            text = xml if xml is not None else f"<testsuites>{''.join(cases)}</testsuites>"
            (folder / "xml" / "a.xml").write_text(text)
            out = folder / "trace.md"
            stderr = io.StringIO()
            with contextlib.redirect_stderr(stderr):
                status = trace.main(["--requirements", str(folder / "requirements.md"),
                                     "--xml", str(folder / "xml"), "--out", str(out)])
            written = out.read_text() if out.exists() else None
        self.assertEqual(written is not None, status == 0)  # whole or not at all
        return status, stderr.getvalue(), written

    def assert_problem(self, expected, status, stderr, _):
        self.assertEqual(status, 1)
        self.assertIn(expected, stderr)

    def test_accepts_a_complete_trace(self):
        status, stderr, written = self.run_trace(BOTH)
        self.assertEqual((status, stderr), (0, ""))
        self.assertIn("| SR-01 | H-01 | The gate shall refuse. | `Gate.A` |", written)

    def test_accepts_several_ids_in_one_tag(self):
        self.assertEqual(self.run_trace([case("A", TAG.format("SR-01, SR-02"))])[0], 0)

    def test_accepts_the_attribute_of_older_googletest(self):
        old = '<testcase name="C" classname="Gate" status="run" requirement="SR-02"/>'
        self.assertEqual(self.run_trace([BOTH[0], old])[0], 0)

    def test_refuses_an_untested_requirement(self):
        self.assert_problem("SR-02: untested", *self.run_trace(BOTH[:1]))

    def test_refuses_an_unknown_id(self):
        self.assert_problem("unknown requirement SR-99",
                            *self.run_trace(BOTH + [case("C", TAG.format("SR-99"))]))

    def test_refuses_a_skipped_test(self):
        self.assert_problem("Gate.C: skipped: no reason given", *self.run_trace(BOTH + [case("C", "<skipped/>")]))
        self.assert_problem("Gate.C: skipped: no AVX2 here",
                            *self.run_trace(BOTH + [case("C", '<skipped message="no AVX2 here"/>')]))

    def test_refuses_a_disabled_test(self):
        self.assert_problem("Gate.C: skipped", *self.run_trace(BOTH + [case("C", "", "notrun")]))

    def test_refuses_a_failed_test_and_does_not_count_it(self):
        failed = case("B", TAG.format("SR-02") + '<failure message="x"/>')
        result = self.run_trace([BOTH[0], failed])
        self.assert_problem("Gate.B: failed", *result)
        self.assert_problem("SR-02: untested", *result)

    def test_refuses_a_requirement_defined_twice(self):
        twice = REQUIREMENTS + "| SR-01 | It shall. | now | H-01 | x |\n"
        self.assert_problem("SR-01: defined twice", *self.run_trace(BOTH, twice))

    def test_refuses_a_requirement_with_two_shalls(self):
        two = REQUIREMENTS.replace("gate shall refuse", "gate shall refuse and shall stop")
        self.assert_problem("SR-01: not exactly one 'shall'", *self.run_trace(BOTH, two))

    def test_refuses_hazards_that_do_not_match(self):
        self.assert_problem("SR-02: hazard H-01 does not name it",
                            *self.run_trace(BOTH, hazards=HAZARDS.replace(", SR-02", "")))
        self.assert_problem("H-01: requirement SR-03 does not name it",
                            *self.run_trace(BOTH, hazards=HAZARDS.replace("SR-02", "SR-02, SR-03")))

    def test_reports_unreadable_input_as_such(self):
        for arguments in ({"xml": "<testsuites>"}, {"xml": "<testsuites/>"}, {"requirements": ""},
                          {"requirements": "| SR-01 | It shall. |"}):
            status, stderr, _ = self.run_trace(BOTH, **arguments)
            self.assertEqual(status, 2, arguments)
            self.assertTrue(stderr.startswith("trace: "), stderr)


if __name__ == "__main__":
    unittest.main()
