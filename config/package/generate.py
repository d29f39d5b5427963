#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Manual pages and bash completion from the programs' own --help, so that they cannot differ."""
import argparse
import gzip
import pathlib
import re
import shutil
import subprocess
import sys

PROGRAMS = {
    "holdfastd": "the real-time daemon on the robot control PC",
    "holdfast-guard": "the second opinion: its own permission beside the daemon's",
    "holdfast-dashboard": "a read-only page for a second monitor",
    "holdfast-outlets": "ROS 2 topics and OpenIGTLink, for eyes only",
    "holdfast": "set-up, measurement and operation of Holdfast",
}


def help_of(words):
    done = subprocess.run([*words, "--help"], capture_output=True, text=True, check=False)
    if done.returncode != 0 or not done.stdout:
        sys.exit(f"{' '.join(words)} --help: exit code {done.returncode}: {done.stderr}")
    return done.stdout


def subcommands(text):
    """name -> first line of its description."""
    block = re.search(r"^Subcommands:\n((?:  .*\n?)+)", text, re.MULTILINE)
    if not block:
        return {}
    return dict(re.findall(r"^  (\S+)\s+(.*)$", block.group(1), re.MULTILINE))


def options(text):
    return sorted(set(re.findall(r"^\s+(?:-\w,)?(--[a-z][a-z0-9-]*)", text, re.MULTILINE)))


def write_page(args, words, summary, out):
    page = subprocess.run(
        [args.help2man, "--no-info", "--no-discard-stderr", "--section=1", f"--name={summary}",
         f"--version-string={args.version}", "--source=Holdfast", " ".join(words)],
        capture_output=True, text=True, check=False)
    if page.returncode != 0:
        sys.exit(f"help2man {' '.join(words)}: {page.stderr}")
    name = "-".join([pathlib.Path(words[0]).name, *words[1:]])
    # help2man takes a command for a section, and dates the page: neither is meant.
    title = f'.TH {name.upper()} "1" "" "Holdfast {args.version}" "User Commands"'
    text = re.sub(r"^\.TH .*$", lambda _: title, page.stdout, count=1, flags=re.MULTILINE)
    (out / f"{name}.1.gz").write_bytes(gzip.compress(text.encode(), mtime=0))


def completion(program, commands):
    """One function a program: its commands, then the command's options, else files."""
    cases = "".join(f"    {name}) words='{' '.join(words)}' ;;\n" for name, words in sorted(commands.items()) if name)
    name = "_" + program.replace("-", "_")
    return (f"# bash completion for {program}; written from its --help\n"
            f"{name}() {{\n  local words current=${{COMP_WORDS[COMP_CWORD]}}\n"
            f"  case ${{COMP_WORDS[1]}} in\n{cases}    *) words='{' '.join(commands[''])}' ;;\n  esac\n"
            f"  if [[ $current == -* || ( $COMP_CWORD -eq 1 && {int(len(commands) > 1)} -eq 1 ) ]]; then\n"
            f"    mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$current\")\n"
            f"  else\n    mapfile -t COMPREPLY < <(compgen -f -- \"$current\")\n  fi\n}}\n"
            f"complete -o filenames -F {name} {program}\n")


def main():
    parser = argparse.ArgumentParser()
    for name in ("bin", "help2man", "version", "out"):
        parser.add_argument(f"--{name}", required=True)
    args = parser.parse_args()
    out = pathlib.Path(args.out)
    shutil.rmtree(out, ignore_errors=True)
    for folder in ("man1", "completions"):
        (out / folder).mkdir(parents=True)
    for program, summary in PROGRAMS.items():
        path = f"{args.bin}/{program}"
        text = help_of([path])
        write_page(args, [path], summary, out / "man1")
        known = subcommands(text)
        words = {"": [*known, *options(text)]}
        for command, line in known.items():
            write_page(args, [path, command], line.rstrip("."), out / "man1")
            words[command] = options(help_of([path, command]))
        (out / "completions" / program).write_text(completion(program, words))


if __name__ == "__main__":
    main()
