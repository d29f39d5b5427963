#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Traces safety requirements to the tests that verify them.

Reads the requirement tables (rows `| SR-nn | text | bound | hazards | verified in |`), the hazard
table beside them, and the XML that GoogleTest writes (`--gtest_output=xml:DIR/` or the environment
variable GTEST_OUTPUT). A test names what it verifies with RecordProperty("requirement", "SR-nn").

Fails, naming each, on: an unknown id; a requirement no passing test verifies; a failed, skipped or
disabled test; a requirement without exactly one "shall"; hazards and requirements that do not refer
to each other. Then nothing is written.

Example: trace.py --requirements docs/safety/requirements.md --xml build/xml --out trace.md
Exit status: 0 complete, 1 incomplete, 2 bad usage or unreadable input.
"""
import argparse
import os
import pathlib
import re
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from skipped_tests import reason_of  # noqa: E402 (the folder above)

ID = re.compile(r"\b(?:SR|H)-\d+\b")


class InputError(Exception):
    """The input cannot be read as what it should be."""


@dataclass
class Requirement:
    text: str
    hazards: list
    folder: str
    tests: list = field(default_factory=list)


def rows(text, prefix):
    """The cells of each table row whose first cell is an id with this prefix."""
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.lstrip().startswith("|") and re.fullmatch(prefix + r"-\d+", cells[0]):
            yield cells


def read_requirements(text):
    requirements, problems = {}, []
    for cells in rows(text, "SR"):
        if len(cells) != 5:
            raise InputError(f"{cells[0]}: {len(cells)} cells in the row, expected 5")
        if cells[0] in requirements:
            problems.append(f"{cells[0]}: defined twice")
        if len(re.findall(r"\bshall\b", cells[1])) != 1:
            problems.append(f"{cells[0]}: not exactly one 'shall'")
        requirements[cells[0]] = Requirement(cells[1], ID.findall(cells[3]), cells[4])
    if not requirements:
        raise InputError("no requirement found")
    return requirements, problems


def check_hazards(text, requirements):
    """Each hazard must name requirements that name it, and the reverse."""
    hazards = {cells[0]: set(ID.findall(cells[-1])) for cells in rows(text, "H")}
    from_hazards = {(sr, h) for h, srs in hazards.items() for sr in srs}
    from_requirements = {(sr, h) for sr, r in requirements.items() for h in r.hazards}
    problems = [f"{sr}: hazard {h} does not name it" for sr, h in from_requirements - from_hazards]
    problems += [f"{h}: requirement {sr} does not name it" for sr, h in from_hazards - from_requirements]
    problems += [f"{h}: no requirement stands against it" for h, srs in hazards.items() if not srs]
    problems += [f"{sr}: names no hazard" for sr, r in requirements.items() if not r.hazards]
    return sorted(problems)


def tagged_ids(case):
    values = [p.get("value", "") for p in case.iter("property") if p.get("name") == "requirement"]
    values.append(case.get("requirement", ""))  # older GoogleTest writes an attribute
    return [item.strip() for value in values for item in value.split(",") if item.strip()]


def read_results(paths, requirements):
    """Enters each passed, tagged test into its requirements; returns the problems."""
    problems, count = [], 0
    for path in paths:
        try:
            root = ElementTree.parse(path).getroot()
        except (ElementTree.ParseError, OSError) as error:
            raise InputError(f"{path}: {error}") from error
        for case in root.iter("testcase"):
            count += 1
            test = f"{case.get('classname')}.{case.get('name')}"
            if case.find("failure") is not None or case.find("error") is not None:
                problems.append(f"{test}: failed")
                continue
            skip_reason = reason_of(case)
            if skip_reason is not None or case.get("status") == "notrun":
                problems.append(f"{test}: skipped: {skip_reason or 'not run'}")
                continue
            for requirement in tagged_ids(case):
                if requirement not in requirements:
                    problems.append(f"{test}: unknown requirement {requirement}")
                elif test not in requirements[requirement].tests:
                    requirements[requirement].tests.append(test)
    if count == 0:
        raise InputError("no test result found")
    return problems


def trace_table(requirements):
    lines = [
        "# Trace: requirements to tests",
        "",
        "Written by `tests/safety/trace.py` from the test results; do not edit.",
        "",
        "| Requirement | Hazards | Text | Tests |",
        "|---|---|---|---|",
    ]
    for name, requirement in sorted(requirements.items()):
        tests = "<br>".join(f"`{test}`" for test in sorted(requirement.tests))
        lines.append(f"| {name} | {', '.join(requirement.hazards)} | {requirement.text} | {tests} |")
    return "\n".join(lines) + "\n"


def write_whole(path, text):
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def trace(arguments):
    requirements, problems = read_requirements(arguments.requirements.read_text(encoding="utf-8"))
    hazards = arguments.hazards or arguments.requirements.with_name("hazards.md")
    problems += check_hazards(hazards.read_text(encoding="utf-8"), requirements)
    files = sorted(file for folder in arguments.xml for file in folder.rglob("*.xml"))
    problems += read_results(files, requirements)
    problems += [f"{name}: untested (expected in {requirement.folder})"
                 for name, requirement in sorted(requirements.items()) if not requirement.tests]
    if problems:
        for problem in problems:
            print(problem, file=sys.stderr)
        print(f"trace: {len(problems)} problem(s)", file=sys.stderr)
        return 1
    table = trace_table(requirements)
    if arguments.out:
        write_whole(arguments.out, table)
    else:
        sys.stdout.write(table)
    return 0


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--requirements", type=pathlib.Path, required=True)
    parser.add_argument("--hazards", type=pathlib.Path, help="default: hazards.md beside them")
    parser.add_argument("--xml", type=pathlib.Path, required=True, action="append",
                        help="folder with GoogleTest XML, searched recursively; repeatable")
    parser.add_argument("--out", type=pathlib.Path, help="default: standard output")
    try:
        return trace(parser.parse_args(argv))
    except (InputError, OSError, UnicodeDecodeError) as error:
        print(f"trace: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
