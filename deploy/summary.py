#!/usr/bin/env python3
"""Sums up a JUnit file that ctest wrote: what failed, what was skipped, what was slow, and the counts.

    summary.py RESULTS.xml      exit 0 when at least one test ran and none failed
"""
import sys
import xml.etree.ElementTree as ElementTree


def main():
    try:
        suite = ElementTree.parse(sys.argv[1]).getroot()
    except (IndexError, OSError, ElementTree.ParseError) as error:
        print("summary.py: no test results: %s" % error)
        return 1
    groups = {"run": [], "fail": [], "notrun": [], "disabled": []}
    for case in suite.iter("testcase"):
        status = case.get("status")
        name, seconds = case.get("name"), float(case.get("time") or 0)
        # A test that was skipped on purpose has its own message; one that was not built or not found has failed.
        skipped = case.find("skipped")
        if status == "notrun" and (skipped is None or not skipped.get("message", "").startswith("SKIP_")):
            status = "fail"
        groups.setdefault(status, []).append((name, seconds))
    passed, failures = groups["run"], groups["fail"]
    skips = groups["notrun"] + groups["disabled"]
    slowest = sorted(passed + failures, key=lambda test: -test[1])[:5]
    print("slowest: " + ", ".join("%s %.1f s" % test for test in slowest))
    for title, tests in (("skipped", skips), ("failed", failures)):
        for name, _ in tests:
            print("%s: %s" % (title, name))
    print("%d passed, %d failed, %d skipped" % (len(passed), len(failures), len(skips)))
    return 1 if failures or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
