# SPDX-License-Identifier: GPL-2.0-or-later
"""Runs suites of tests on something planted, until one test fails: first those that failed the latest times."""
import re
import subprocess

MAX_FIRST = 6  # tests that run first
# A name may have " - " between its brackets; behind it stands why it failed.
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+?::[^\[\s]+(?:\[.*?\](?= - |$))?)", re.MULTILINE)


def failed_test(suite, command=("pytest-3",), **options):
    """The first test of a suite that fails, None if all pass; a suite that cannot be collected counts as one that fails."""
    done = subprocess.run([*command, "-q", "-x", "-rfE", "-p", "no:cacheprovider", *suite], capture_output=True, text=True, check=False,
                          **options)
    failed = FAILED.search(done.stdout)
    assert failed or done.returncode in (0, 1, 2), f"{suite}: {done.stdout[-1000:]}{done.stderr[-500:]}"
    return failed[1] if failed else suite[0] if done.returncode else None


class Witnesses:
    """The tests that failed before, the latest first."""

    def __init__(self):
        self.known = []

    def failed_test(self, suites, run):
        """The first test that fails; run(suite) is failed_test with what is planted."""
        first = [self.known[:MAX_FIRST]] if self.known else []
        for suite in [*first, *suites]:
            test = run(suite)
            if test:
                if "::" in test:
                    self.known = [test, *(one for one in self.known if one != test)]
                return test
        return None
