# SPDX-License-Identifier: GPL-2.0-or-later
"""Subjects of commits fit into one line of `git log`: those since the last tag, if that is newer than this rule."""
import pathlib
import subprocess

TOP = pathlib.Path(__file__).resolve().parents[2]
MAX_SUBJECT = 72


def git(*arguments):
    done = subprocess.run(["git", "-c", "safe.directory=*", "-C", TOP, *arguments], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_subjects_are_short():
    rule = git("log", "--diff-filter=A", "--format=%H", "-1", "--", __file__)  # the commit that brought it
    tags = git("tag", "--merged", "HEAD", "--contains", *rule, "--sort=-creatordate") if rule else []
    newer = [git("log", "--no-merges", "--format=%s", f"{base}..HEAD") for base in (tags or rule)[:1]]
    subjects = set(sum(newer, git("log", "--no-merges", "--format=%s", "-1")))
    assert subjects
    assert {subject for subject in subjects if len(subject) > MAX_SUBJECT} == set()
