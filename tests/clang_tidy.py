#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs clang-tidy over every translation unit of the product and the simulated devices; fails on any
finding.

Test and benchmark sources (*_test.cpp, *_bench.cpp) and the renderer (tests/sim/or) are left to the
compiler's warnings: reading them would double the time and they run nowhere but here.

A unit whose content, headers of ours, flags and checks have passed before is not read again: the
key of a pass is a hash over all of them, so a stale pass cannot hide a finding."""
import argparse
import concurrent.futures
import hashlib
import json
import os
import re
import subprocess
import sys

INCLUDE = re.compile(r'^\s*#\s*include\s*"([^"]+)"', re.MULTILINE)


def headers_of(path, root, seen):
    with open(path, encoding="utf-8") as stream:
        text = stream.read()
    for name in INCLUDE.findall(text):
        header = os.path.join(root, name)
        if header not in seen and os.path.exists(header):
            seen.add(header)
            headers_of(header, root, seen)
    return seen


def key_of(entry, root, tidy_version, config):
    digest = hashlib.sha256((tidy_version + config + entry["command"].replace(root, "")).encode())
    for path in [entry["file"], *sorted(headers_of(entry["file"], root, set()))]:
        with open(path, "rb") as stream:
            digest.update(path.replace(root, "").encode() + b"\0" + stream.read())
    return digest.hexdigest()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", required=True)
    parser.add_argument("--cache", required=True)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    root = os.getcwd()
    os.makedirs(args.cache, exist_ok=True)
    with open(os.path.join(args.build, "compile_commands.json"), encoding="utf-8") as stream:
        entries = json.load(stream)
    is_wanted = re.compile(r"^(?!tests/sim/or/)(?!.*_(test|bench)\.cpp$)").match
    tracked = set(filter(is_wanted, subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.cpp"],
                                 capture_output=True, text=True, check=True).stdout.split()))
    entries = [e for e in entries if os.path.relpath(e["file"], root) in tracked]
    unread = tracked - {os.path.relpath(e["file"], root) for e in entries}
    if unread:
        # Programs that a test builds by itself are not part of the build; they say so in their path.
        unread = {p for p in unread if "/example/" not in p}
    if unread:
        sys.exit(f"clang-tidy: not in the build, so not read: {' '.join(sorted(unread))}")
    version = subprocess.run(["clang-tidy", "--version"], capture_output=True, text=True, check=True).stdout
    with open(".clang-tidy", encoding="utf-8") as stream:
        config = stream.read()

    def check(entry):
        name = os.path.relpath(entry["file"], root)
        passed = os.path.join(args.cache, key_of(entry, root, version, config))
        if os.path.exists(passed):
            return name, 0, ""
        run = subprocess.run(["clang-tidy", "--quiet", "-p", args.build, entry["file"]],
                             capture_output=True, text=True, check=False)
        if run.returncode == 0:
            with open(passed, "w", encoding="utf-8"):
                pass
        return name, run.returncode, run.stdout + run.stderr

    failed = []
    with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
        for name, code, output in pool.map(check, entries):
            if code:
                failed.append(name)
                print(output, file=sys.stderr)
    if failed or not entries:
        sys.exit(f"clang-tidy: findings in {len(failed)} of {len(entries)} units: {' '.join(failed)}")
    print(f"clang-tidy: {len(entries)} units, no finding")


if __name__ == "__main__":
    main()
