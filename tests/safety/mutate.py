#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Mutation testing of safety/: small faults are put into its sources, one at a time, and the unit tests must see each.

A mutant changes one operator, constant or condition, or leaves out one statement. Each is compiled (-O1, with the library's assertions) and run
against the gate's and the end-to-end protection's unit tests. Killed: a test failed, crashed or hung. Survived: all
passed; each survivor must be in tests/safety/mutants.txt with its reason. A mutant that does not compile counts as
neither. Before anything counts, the untouched sources must pass, a mutant that changes nothing must survive, and
every seeded mutant must be killed: a runner that always says "killed" proves nothing.

Example: mutate.py --sample 100 --seed 1 --json mutants.json
Exit code: 0 every survivor is justified; 1 not, each on stderr; 2 the self-check failed."""
import argparse
import concurrent.futures
import json
import pathlib
import random
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
TESTS = ["composition", "crc32c", "end_to_end", "gate_fault", "gate_hold", "gate_invariant", "gate_latched_stop",
         "gate_optics", "gate_registration", "gate", "limit_suite", "limits", "mode_table", "numbers", "reason"]
FLAGS = ["-std=c++20", "-O1", "-w", "-D_GLIBCXX_ASSERTIONS", "-I.", "-isystem", "/usr/include/eigen3",
         f'-DHOLDFAST_MODES_MD="{ROOT}/docs/safety/modes.md"']
COMMON_HEADERS = ["algorithm", "array", "chrono", "functional", "optional", "sstream", "string", "vector",
                  "Eigen/Cholesky", "Eigen/Eigenvalues", "Eigen/Geometry", "gtest/gtest.h"]
RUN_MAX_S = 120
SWAPS = [(" < ", " <= "), (" <= ", " < "), (" > ", " >= "), (" >= ", " > "), (" < ", " > "), (" > ", " < "),
         (" == ", " != "), (" != ", " == "), (" && ", " || "), (" || ", " && "), (" + ", " - "), (" - ", " + "),
         (" * ", " / "), ("true", "false"), ("false", "true"), ("std::max", "std::min"), ("std::min", "std::max")]
STATEMENT = re.compile(r"^\s+(?!return|const |using |break|case|for |[}{]|double |Duration |Matrix6d |Eigen::|static )"
                       r"[\w.:>()-]+(?:\.insert|\.erase|\.set| = | \+?\^?= |\.reset)[^;]*;$")
SEEDED = [  # file, original, mutant: each must be killed
    ("gate.cpp", "state.is_keyframe_verified = false;", ";"),
    ("gate.cpp", "elapsed(state.t_hold_entered, inputs.now) > limits.hold_max", "false"),
    ("acknowledgement.cpp", "since_acknowledged >= limits.confirm_min", "true"),
    ("monitors.cpp", "age > limits.robot_silence_max", "age < limits.robot_silence_max"),
    ("monitors.cpp", "exceeds(tracking.drift_mm, limits.drift_max_mm)", "tracking.drift_mm > limits.drift_max_mm + 1"),
    ("numbers.cpp", "std::isfinite(value) && value >= 0", "value >= 0"),
    ("end_to_end.cpp", "step == 0 || step >= kHalfRange", "step >= kHalfRange"),
    ("crc32c.cpp", "0x82F63B78", "0x82F63B79"),
    ("mode_table.cpp", "Reason::clock_step, ", ""),
    ("composition.cpp", "-skew(arm)", "skew(arm)")]


def code_lines(path):
    """Line numbers and text without comments; no preprocessor, no names of reasons and verdicts."""
    for number, line in enumerate(path.read_text().splitlines()):
        code = line.split("//")[0].rstrip()
        if code and not code.lstrip().startswith(("#", "case ", "using ", "namespace")):
            yield number, code


def mutants_of(path):
    for number, code in code_lines(path):
        seen = set()

        def places(pattern):  # outside of quoted text
            return (m for m in re.finditer(pattern, code) if code[:m.start()].count('"') % 2 == 0)
        for old, new in SWAPS:
            for match in places(re.escape(old)):
                seen.add(code[:match.start()] + new + code[match.end():])
        for match in places(r"!(?=[\w(])"):
            seen.add(code[:match.start()] + code[match.end():])
        for match in places(r"(?<![\w.<'])(\d+(?:\.\d+)?)(?![\w.'>])"):
            number_text = match.group(1)
            other = str(float(number_text) + 1) if "." in number_text else str(int(number_text) + 1)
            seen.add(code[:match.start()] + other + code[match.end():])
        if STATEMENT.match(code):
            seen.add(re.match(r"\s*", code).group() + ";")
        seen.discard(code)
        for mutated in sorted(seen):
            yield path.name, number, code, mutated


class Bench:
    """Everything but the mutated file, compiled once."""

    def __init__(self, folder, jobs):
        self.folder, self.pool = folder, concurrent.futures.ThreadPoolExecutor(jobs)
        # What all of them include, compiled once: most of a mutant's time is Eigen.
        common = self.folder / "common.hpp"
        common.write_text("".join(f"#include <{h}>\n" for h in COMMON_HEADERS))
        self.flags = [*FLAGS, "-include", str(common)]
        subprocess.run(["g++", *FLAGS, "-x", "c++-header", str(common), "-o", f"{common}.gch"], cwd=ROOT, check=True)
        self.sources = sorted((ROOT / "safety").glob("*.cpp"))
        tests = [ROOT / f"tests/safety/{name}_test.cpp" for name in TESTS] + [ROOT / "tests/safety/faults.cpp"]
        built = list(self.pool.map(lambda f: self.compile(f, self.folder / f"{f.stem}.o"), self.sources + tests))
        if not all(built):
            raise SystemExit("mutate: the untouched sources do not compile")
        self.tests = [self.folder / f"{f.stem}.o" for f in tests]

    def compile(self, source, target):
        return subprocess.run(["g++", *self.flags, "-c", str(source), "-o", str(target)], cwd=ROOT,
                              stderr=subprocess.DEVNULL, check=False).returncode == 0

    def outcome(self, name, text):
        """killed, survived or invalid, of safety/NAME with this text."""
        with tempfile.TemporaryDirectory(dir=self.folder) as work:
            work = pathlib.Path(work)
            (work / name).write_text(text)
            if not self.compile(work / name, work / "mutant.o"):
                return "invalid"
            others = [str(self.folder / f"{f.stem}.o") for f in self.sources if f.name != name]
            linked = subprocess.run(["g++", str(work / "mutant.o"), *others, *map(str, self.tests), "-o",
                                     str(work / "tests"), "-lgtest_main", "-lgtest", "-lpthread"],
                                    stderr=subprocess.DEVNULL, check=False)
            if linked.returncode != 0:
                return "invalid"
            try:
                run = subprocess.run([str(work / "tests"), "--gtest_brief=1", "--gtest_fail_fast"],
                                     stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=RUN_MAX_S,
                                     check=False)
            except subprocess.TimeoutExpired:
                return "killed"
            return "survived" if run.returncode == 0 else "killed"

    def mutant_outcome(self, mutant):
        name, number, _, mutated = mutant
        lines = (ROOT / "safety" / name).read_text().splitlines()
        lines[number] = mutated
        return mutant, self.outcome(name, "\n".join(lines) + "\n")


def self_check(bench):
    """What is wrong with the runner or the seeded mutants, a line each."""
    problems = []
    gate = (ROOT / "safety/gate.cpp").read_text()
    if bench.outcome("gate.cpp", gate + "// nothing changed\n") != "survived":
        problems.append("the untouched sources do not pass")

    def judge(seeded):
        name, old, new = seeded
        text = (ROOT / "safety" / name).read_text()
        if old not in text:
            return f"seeded mutant of {name} is outdated: '{old}' is not there"
        outcome = bench.outcome(name, text.replace(old, new, 1))
        return None if outcome == "killed" else f"seeded mutant of {name} {outcome}: '{old}' -> '{new}'"
    problems += [problem for problem in bench.pool.map(judge, SEEDED) if problem]
    return problems


def justified():
    """Original and mutated line (blanks apart) of every survivor that is accepted."""
    known = set()
    for line in (ROOT / "tests/safety/mutants.txt").read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            name, old, new, _ = (part.strip() for part in line.split(" | ", 3))
            known.add((name, old, new))
    return known


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, metavar="N", help="only N of the mutants, drawn by --seed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--file", action="append", help="only mutants of this file, as gate.cpp; may be repeated")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE")
    arguments = parser.parse_args()
    mutants = [m for path in sorted((ROOT / "safety").glob("*.cpp")) for m in mutants_of(path)
               if not arguments.file or path.name in arguments.file]
    total = len(mutants)
    if arguments.sample and arguments.sample < total:
        mutants = random.Random(arguments.seed).sample(mutants, arguments.sample)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(pathlib.Path(folder), arguments.jobs)
        problems = self_check(bench)
        for problem in problems:
            print(f"mutate: {problem}", file=sys.stderr)
        if problems:
            return 2
        known, counts, unjustified = justified(), {"killed": 0, "survived": 0, "invalid": 0}, []
        for tried, ((name, number, old, new), outcome) in enumerate(bench.pool.map(bench.mutant_outcome, mutants), 1):
            counts[outcome] += 1
            if sys.stderr.isatty() or tried % 50 == 0:
                print(f"mutate: {tried} of {len(mutants)}, {counts['survived']} survived", file=sys.stderr, flush=True)
            if outcome == "survived" and (name, old.strip(), new.strip()) not in known:
                unjustified.append(f"{name}:{number + 1} | {old.strip()} | {new.strip()}")
                print(f"survived: {unjustified[-1]}", file=sys.stderr, flush=True)
    valid = counts["killed"] + counts["survived"]
    result = {**counts, "mutants": total, "tried": len(mutants), "seeded_killed": len(SEEDED),
              "justified": counts["survived"] - len(unjustified),
              "score": round(counts["killed"] / valid, 4) if valid else None, "unjustified": unjustified}
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({key: value for key, value in result.items() if key != "unjustified"}, indent=1))
    return 1 if unjustified else 0


if __name__ == "__main__":
    sys.exit(main())
