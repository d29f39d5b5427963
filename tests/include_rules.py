#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The dependency rule of the house, checked line by line: which folder may include what.

Also checks that every source file carries its licence line and that headers have #pragma once."""
import re
import subprocess
import sys

EIGEN = r"Eigen/"
OPENCV = r"opencv2/"
LOCAL = "safety perception registration bridge rt/core rt tests".split()
# Folder -> (rooms whose headers it may include, foreign headers it may include). Longest prefix wins.
RULES = {
    "safety": (["safety"], [EIGEN]),
    "perception": (["perception"], [EIGEN, OPENCV]),
    "registration": (["registration", "rt/core"],
                     [EIGEN, OPENCV, r"nlohmann/", r"openssl/", r"fmt/", r"ceres/", r"nanoflann", r"nlopt\.hpp$", r"boost/math/"]),
    "registration/ct": (["registration", "rt/core"], [EIGEN, OPENCV, r"fmt/", r"gdcm", r"vtk"]),
    "bridge/client": (["bridge", "safety", "rt/core"], [r"dds/", r"holdfast\.h$"]),
    "bridge/client/example": ([], [r"holdfast/client\.hpp$"]),
    "bridge": (["bridge", "safety", "perception", "registration", "rt/core"],
               [EIGEN, OPENCV, r"arv\.h$", r"glib", r"dds/", r"holdfast\.h$", r"toml\+\+/", r"fmt/", r"openssl/",
                r"CLI/", r"nlohmann/", r"tiffio\.h$", r"zlib\.h$", r"SDL2/", r"systemd/"]),
    "bridge/openigtlink": (["bridge/openigtlink", "rt/core"], [EIGEN, r"igtl", r"fmt/"]),
    "bridge/http": (["bridge/http", "rt/core"], [r"boost/(asio|beast)/", r"fmt/"]),
    "rt/core": (["rt/core"], []),
    "rt": (["rt", "safety", "perception", "registration", "bridge"],
           [EIGEN, OPENCV, r"fmt/", r"spdlog/", r"CLI/", r"nlohmann/"]),
    "rt/study": (["rt", "safety/reason.hpp", "perception", "registration", "bridge"],
                 [EIGEN, OPENCV, r"fmt/", r"nlohmann/", r"toml\+\+/"]),
    "rt/guard": (["rt/guard", "bridge", "safety/end_to_end.hpp", "rt/core"], [EIGEN, r"fmt/", r"dds/"]),
    "tests": (LOCAL, [r".*"]),
}
# The C library and the operating system, by folder: decisions and vision need none of it.
SYSTEM_FREE = ("safety", "perception")
SYSTEM = re.compile(r"^(sys/|linux/|net/|netinet/|arpa/)|^(unistd|sched|pthread|signal|fcntl|poll|"
                    r"time|errno|dirent|spawn|malloc|dlfcn|alloca)\.h$")
STANDARD = re.compile(r"^[a-z_0-9]+$|^(immintrin|nmmintrin|x86intrin)\.h$")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')


def rule_of(path):
    folder = max((f for f in RULES if path.startswith(f + "/")), key=len, default=None)
    return folder, RULES.get(folder)


def allowed_local(target, rooms):
    if target.startswith("rt/core/"):
        return "rt/core" in rooms or "rt" in rooms
    return any(target == room or target.startswith(room + "/") for room in rooms)


def violations(path, lines):
    folder, rule = rule_of(path)
    if rule is None:
        return
    rooms, foreign = rule
    for number, line in enumerate(lines, 1):
        match = INCLUDE.match(line)
        if not match:
            continue
        target = match.group(2)
        is_local = any(target.startswith(room + "/") for room in LOCAL)
        if is_local:
            fine = allowed_local(target, rooms)
        elif any(re.match(pattern, target) for pattern in foreign) or STANDARD.match(target):
            fine = True
        else:
            fine = bool(SYSTEM.match(target)) and folder not in SYSTEM_FREE
        if not fine:
            yield f"{path}:{number}: {folder}/ may not include {target}"


def self_test():
    bad = [("safety/x.cpp", '#include "bridge/y.hpp"'), ("safety/x.cpp", "#include <unistd.h>"),
           ("perception/x.cpp", '#include "registration/y.hpp"'), ("rt/core/x.cpp", "#include <Eigen/Core>"),
           ("rt/core/x.cpp", '#include "rt/doctor.hpp"'), ("registration/x.cpp", '#include "perception/y.hpp"'),
           ("rt/guard/x.cpp", '#include "rt/control_step.hpp"'), ("rt/guard/x.cpp", '#include "safety/gate.hpp"')]
    good = [("safety/x.cpp", "#include <Eigen/Core>"), ("rt/x.cpp", '#include "bridge/y.hpp"'),
            ("rt/core/x.cpp", "#include <pthread.h>"), ("rt/core/x.cpp", '#include "rt/core/y.hpp"')]
    missed = [case for case in bad if not list(violations(case[0], [case[1]]))]
    false_alarms = [case for case in good if list(violations(case[0], [case[1]]))]
    if missed or false_alarms:
        sys.exit(f"include_rules.py is broken: missed {missed}, false alarms {false_alarms}")


def main():
    self_test()
    files = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "--",
                            "*.cpp", "*.hpp"], capture_output=True, text=True, check=True).stdout.split()
    found = []
    for path in files:
        with open(path, encoding="utf-8") as stream:
            lines = stream.read().splitlines()
        found += violations(path, lines)
        if not lines or not lines[0].startswith("// SPDX-License-Identifier: Apache-2.0"):
            found.append(f"{path}:1: the first line is not the SPDX line")
        if path.endswith(".hpp") and "#pragma once" not in lines:
            found.append(f"{path}:1: no #pragma once")
    print("\n".join(found), file=sys.stderr)
    if not files or found:
        sys.exit(f"include rules: {len(found)} violations in {len(files)} files")
    print(f"include rules: {len(files)} files, no violation")


if __name__ == "__main__":
    main()
