#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Prints each skipped test in the given GoogleTest XML files, with the reason it gave."""
import sys
from xml.etree import ElementTree


def reason_of(case):
    """Why the test was skipped, without the place in the source; None when it was not."""
    skipped = case.find("skipped")
    if skipped is None:
        return None
    lines = (skipped.get("message") or skipped.text or "").strip().splitlines()
    return lines[-1] if lines else "no reason given"


def main():
    for path in sys.argv[1:]:
        for case in ElementTree.parse(path).getroot().iter("testcase"):
            reason = reason_of(case)
            if reason is not None:
                print(f"skipped: {case.get('classname')}.{case.get('name')}: {reason}")


if __name__ == "__main__":
    main()
