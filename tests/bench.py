#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the benchmark programs one after another and gathers their figures in one list.

Each program writes a JSON list of {name, median, p99, unit, baseline, ratio, ...}; what a program
could not measure it leaves out and says so on stderr."""
import argparse
import json
import os
import subprocess
import sys
import tempfile

# Program, arguments of a full run, arguments of a quick one.
PROGRAMS = [
    ("holdfast-bench-tracker", [], []),
    ("holdfast-bench-reconstruct", [], ["--quick"]),
    ("holdfast-bench-ct", [], ["--quick"]),
    ("holdfast-bench-render", [], ["--runs", "3"]),
    ("holdfast-bench-dds", [], ["--quick"]),
    ("holdfast-bench-camera", [], ["--seconds", "2"]),
    ("holdfast-bench-loop", ["--seconds", "60", "--load", "2"], ["--seconds", "5"]),
    ("holdfast-bench-handover", [], ["--exchanges", "10000000"]),
    ("holdfast-bench-recorder", [], ["--seconds", "2"]),
    ("holdfast-bench-dashboard", [], ["--seconds", "3"]),
    ("holdfast-bench-dashboard", ["--live"], ["--live", "--seconds", "3"]),
    ("holdfast-sim", ["reactions", "--runs", "200"], ["reactions", "--runs", "10"]),
    ("holdfast-sim", ["kills", "--runs", "100"], ["kills", "--runs", "3"]),
]


def run(program, arguments):
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "result.json")
        print(f"== {os.path.basename(program)} {' '.join(arguments)}", file=sys.stderr, flush=True)
        code = subprocess.run([program, *arguments, "--json", out], stdout=sys.stderr, check=False).returncode
        if code != 0:
            sys.exit(f"{program}: exit code {code}")
        with open(out, encoding="utf-8") as stream:
            return json.load(stream)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bin", required=True, help="folder of the built programs")
    parser.add_argument("--json", help="write the list to this file")
    parser.add_argument("--quick", action="store_true", help="short runs: less certain figures")
    parser.add_argument("--only", help="only programs whose name or arguments contain this")
    args = parser.parse_args()
    figures = []
    for name, full, quick in PROGRAMS:
        arguments = quick if args.quick else full
        if args.only and args.only not in " ".join([name, *arguments]):
            continue
        figures += run(os.path.join(args.bin, name), arguments)
    for f in figures:
        parts = [f"{key} {f[key]:g}" for key in ("median", "p99", "baseline", "ratio") if f.get(key) is not None]
        print(f"{f['name']:<48} {'  '.join(parts)} {f.get('unit') or ''}")
    if args.json:
        beside = args.json + ".part"
        with open(beside, "w", encoding="utf-8") as stream:
            json.dump(figures, stream, indent=1)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(beside, args.json)


if __name__ == "__main__":
    main()
