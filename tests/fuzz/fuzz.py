#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Every parser of outside bytes under libFuzzer with the address sanitizer.

Undefined behaviour is looked for where the corpus is repeated: the unit tests under g++'s sanitizers. (clang takes
five times as long for these sources when it instruments both.)

Each target starts from its seeds and the committed corpus. What it learns goes to a work folder, so that the next
run goes on from there; --minimise brings the shortest of the inputs that reach new code back to the corpus.

Example: fuzz.py --fuzzer build/fuzz/bin/holdfast-fuzz-parsers --work build/fuzz/work --seconds 60
Exit code: 0 no crash, hang or leak; 1 a finding, whose input is named; 3 the fuzzer is not there."""
import argparse
import concurrent.futures
import json
import os
import pathlib
import re
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
INPUT_MAX = 1 << 16
CORPUS_INPUT_MAX = 4096  # of what is committed
CORPUS_INPUTS_MAX = 40  # of a target, the shortest


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--fuzzer', type=pathlib.Path, required=True, help='the built holdfast-fuzz-parsers')
    parser.add_argument('--work', type=pathlib.Path, required=True, help='folder for inputs and findings')
    parser.add_argument('--seconds', type=int, default=60, help='for each target (default 60)')
    parser.add_argument('--jobs', type=int, default=os.cpu_count(), help='targets at a time')
    parser.add_argument('--target', action='append', help='only this one; may be given again')
    parser.add_argument('--minimise', action='store_true', help='afterwards: the corpus anew, from all that was learnt')
    parser.add_argument('--json', type=pathlib.Path, help='what each target tried')
    return parser.parse_args()


def call(arguments, target, *options):
    log = arguments.work / f'{target}.log'
    with log.open('wb') as output:
        code = subprocess.run([arguments.fuzzer, f'--target={target}', *options], stdout=output,
                              stderr=subprocess.STDOUT, check=False).returncode
    return code, log.read_text(errors='replace')


def limits(arguments, target):
    return [f'-max_len={INPUT_MAX}', '-timeout=10', '-rss_limit_mb=2048', f'-dict={HERE / "dictionary.txt"}',
            f'-artifact_prefix={arguments.work}/{target}.finding.']


def folders(arguments, target):
    learnt, seeds = arguments.work / target, arguments.work / f'{target}.seeds'
    for folder in (learnt, seeds):
        folder.mkdir(parents=True, exist_ok=True)
    call(arguments, target, f'--seeds={seeds}')
    committed = HERE / 'corpus' / target
    return learnt, [seeds] + ([committed] if committed.is_dir() else [])


def fuzz(arguments, target):
    learnt, given = folders(arguments, target)
    began = time.monotonic()
    code, log = call(arguments, target, f'-max_total_time={arguments.seconds}', '-print_final_stats=1',
                     *limits(arguments, target), learnt, *given)
    counted = re.search(r'stat::number_of_executed_units:\s*(\d+)', log)
    reached = re.findall(r'cov: (\d+)', log)
    finding = re.search(r'Test unit written to (\S+)', log)
    result = {'target': target, 'is_clean': code == 0, 'inputs': int(counted.group(1)) if counted else 0,
              'edges': int(reached[-1]) if reached else 0, 'seconds': round(time.monotonic() - began, 1)}
    if code != 0:
        cause = re.search(r'^(?:==\d+==\s*)?((?:SUMMARY|ERROR|libFuzzer: ).*)$', log, re.M)
        result['finding'] = finding.group(1) if finding else str(arguments.work / f'{target}.log')
        result['cause'] = cause.group(1) if cause else f'exit code {code}'
    return result


def minimise(arguments, target):
    """To the corpus, of the least that reaches as much, the shortest."""
    learnt, given = folders(arguments, target)
    merged = arguments.work / f'{target}.merged'
    merged.mkdir(exist_ok=True)
    code, _ = call(arguments, target, '-merge=1', *limits(arguments, target), f'-max_len={CORPUS_INPUT_MAX}', merged,
                   *given, learnt)
    if code != 0:
        raise SystemExit(f'fuzz: merging the corpus of {target} failed: {arguments.work / (target + ".log")}')
    committed = HERE / 'corpus' / target
    committed.mkdir(parents=True, exist_ok=True)
    kept = sorted(merged.iterdir(), key=lambda file: (file.stat().st_size, file.name))[:CORPUS_INPUTS_MAX]
    for file in kept:
        if file.stat().st_size <= CORPUS_INPUT_MAX:
            file.replace(committed / file.name)


def main():
    arguments = parse_arguments()
    if not arguments.fuzzer.is_file():
        print(f'fuzz: {arguments.fuzzer}: not there; build the preset fuzz', file=sys.stderr)
        return 3
    arguments.work.mkdir(parents=True, exist_ok=True)
    suppressions = HERE.parent / 'lsan.supp'
    os.environ['LSAN_OPTIONS'] = f'suppressions={suppressions}:print_suppressions=0'
    names = subprocess.run([arguments.fuzzer, '--targets'], stdout=subprocess.PIPE, text=True,
                           check=True).stdout.split()
    unknown = sorted(set(arguments.target or []) - set(names))
    if unknown:
        print(f'fuzz: --target {unknown[0]}: none of {", ".join(names)}', file=sys.stderr)
        return 2
    results = []
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        for result in pool.map(lambda target: fuzz(arguments, target), arguments.target or names):
            results.append(result)
            print(f'{result["target"]:20} {result["inputs"]:>10} inputs {result["edges"]:>6} edges  '
                  f'{"clean" if result["is_clean"] else result["cause"] + ": " + result["finding"]}', flush=True)
    if arguments.json:
        beside = arguments.json.with_name(arguments.json.name + '.part')
        beside.write_text(json.dumps(results, indent=1) + '\n')
        beside.replace(arguments.json)
    if not all(result['is_clean'] for result in results):
        return 1
    if arguments.minimise:
        for target in arguments.target or names:
            minimise(arguments, target)
    return 0


if __name__ == '__main__':
    sys.exit(main())
