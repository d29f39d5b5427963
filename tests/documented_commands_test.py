#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Every command that README, docs/ and the programs' own --help show can be typed: the program is built, knows the
subcommand, and each --option stands in that command's --help. What the commands do is tested elsewhere.

Usage: documented_commands_test.py ROOT BIN"""
import functools
import pathlib
import re
import shlex
import subprocess
import sys
import unittest

BIN = pathlib.Path(sys.argv.pop())
ROOT = pathlib.Path(sys.argv.pop())
COMMAND = re.compile(r"(?:(?:build/release/)?bin/)?(holdfast[a-z-]*|\./dev) (.*)")
ELLIPSIS = {"…", "..."}


BEHIND_DEV = {"bench": [sys.executable, "-B", ROOT / "tests/bench.py"], "demo": [BIN / "holdfast", "demo"],
              "faults": [BIN / "holdfast-fault"], "rtvm": [sys.executable, "-B", ROOT / "tests/rtvm/rtvm.py"]}


@functools.cache
def help_of(program, subcommand=None):
    if program == "./dev":
        words = BEHIND_DEV.get(subcommand, [ROOT / "dev"])
    else:
        words = [BIN / program, *(subcommand or "").split()]
    done = subprocess.run([*map(str, words), "--help"], capture_output=True, text=True, timeout=60, check=False)
    return done.stdout + done.stderr


def subcommands(program):
    return set(re.findall(r"^  ([a-z][a-z-]+)\b", help_of(program), re.MULTILINE))


def shown_in_text(text):
    """Commands in code: a fenced line, with what a backslash continues; or a `span`."""
    is_fenced = False
    lines = iter(text.splitlines())
    for line in lines:
        if line.lstrip().startswith("```"):
            is_fenced = not is_fenced
            continue
        if not is_fenced:
            yield from re.findall(r"`((?:\./dev|holdfast[a-z-]*) [^`]+)`", line)
            continue
        while line.endswith("\\"):
            line = line[:-1] + next(lines, "")
        line = re.sub(r"^\s*\$ ", "", line).split("  #")[0].strip()
        if COMMAND.match(line):
            yield line


def shown_in_help(text):
    """The indented or labelled examples at the end of a --help."""
    for line in text.splitlines():
        found = re.search(r"(?:^|: +|^ +)((?:\./dev|holdfast[a-z-]*) .*--.*)$", line)
        if found and not line.startswith("Usage"):
            yield found.group(1)


def words_of(command):
    try:
        return shlex.split(command, comments=True)
    except ValueError:  # an apostrophe that is no quote
        return command.split()


def problem_of(command):
    """What is wrong with it, or nothing."""
    program, rest = COMMAND.match(command).groups()
    if program != "./dev" and not (BIN / program).exists():
        return f"no program {program}"
    words = words_of(rest)
    known, told = subcommands(program), help_of(program)
    subcommand = next((w for w in words if not w.startswith("-")), None)
    if subcommand in known:
        told += help_of(program, "demo --setup" if {"demo", "--setup"} <= set(words) else subcommand)
    elif program in ("holdfast", "holdfast-sim", "./dev") and words and not words[0].startswith("-") \
            and words[0] not in ELLIPSIS and words[0].islower():
        return f"{program} knows no '{words[0]}'"
    for word in words:
        option = word.split("=")[0]
        if re.fullmatch(r"--[a-z][a-z-]*", option) and not re.search(re.escape(option) + r"\b(?!-)", told):
            return f"{program} {subcommand or ''} knows no {option}"
    return None


class DocumentedCommands(unittest.TestCase):
    def check(self, where, commands):
        for command in commands:
            with self.subTest(where=where, command=command):
                self.assertIsNone(problem_of(command))

    def test_the_documents(self):
        count = 0
        for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
            commands = list(shown_in_text(path.read_text(encoding="utf-8")))
            count += len(commands)
            self.check(path.relative_to(ROOT), commands)
        self.assertGreater(count, 50)  # or nothing was looked at

    def test_the_examples_in_help(self):
        for program in ("holdfast", "holdfast-sim"):
            examples = 0
            for subcommand in sorted(subcommands(program)):
                commands = list(shown_in_help(help_of(program, subcommand)))
                examples += len(commands)
                self.check(f"{program} {subcommand} --help", commands)
            self.assertGreater(examples, 5, program)

    def test_what_is_wrong_is_seen(self):
        self.assertIn("knows no 'fly'", problem_of("holdfast fly --out x"))
        self.assertIn("--wings", problem_of("holdfast track --wings 2"))
        self.assertIn("no program", problem_of("holdfast-nothing --help"))
        self.assertIn("knows no 'fly'", problem_of("./dev fly"))


if __name__ == "__main__":
    unittest.main()
