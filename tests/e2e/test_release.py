# SPDX-License-Identifier: GPL-2.0-or-later
"""tools/release.sh, which the workflow of a release calls, and make where a program is missing."""
import hashlib
import re
import shutil
import subprocess
import zipfile

import pytest
import levels
import test_installer
import tshark

pytestmark = levels.without_tshark("of git, make and the workflows")

SYSTEM = "/usr/bin:/bin:/usr/sbin:/sbin"
TAG = f"v{tshark.plugin_version()}"
PYTHON = "/usr/bin/python3"


def run(top, *arguments, **env):
    return subprocess.run(list(map(str, arguments)), cwd=top, capture_output=True, text=True, check=False, timeout=300,
                          env={"PATH": SYSTEM, "HOME": str(top), "LC_ALL": "C.UTF-8", **env}, stdin=subprocess.DEVNULL)


def git(top, *commands):
    for words in commands:
        subprocess.run(["git", "-C", top, "-c", "user.name=t", "-c", "user.email=t@t", *words], check=True, capture_output=True)


@pytest.fixture
def repository(folder):
    """A clone of the repository as it lies here, with a tag."""
    if not shutil.which("git"):
        pytest.skip("no git here")
    if not test_installer.git("ls-files"):
        pytest.skip("no repository here")
    top = test_installer.repository(folder / "top")
    git(top, ["init", "-q"], ["add", "-A"], ["commit", "-qm", "x"], ["tag", TAG])
    return top


def test_a_release(folder, repository):
    """What is not in the commit is not in it; the same sums come again, and others are refused."""
    (repository / "docs/mine.md").write_text("mine")
    (repository / "extcap/mine.py").write_text("mine")
    done = run(repository, "tools/release.sh", TAG)
    assert done.returncode == 0, done.stderr
    built = {path.name: path.read_bytes() for path in (repository / "dist").iterdir()}
    assert len(built) == 6 and b"mine.md" not in built[f"yapp-{TAG[1:]}.zip"] and b"mine.py" not in built[f"yapp-{TAG[1:]}.zip"]
    assert done.stdout == built["SHA256SUMS"].decode()
    assert built["notes.md"].decode().strip() in (tshark.ROOT / "CHANGELOG.md").read_text()
    assert "## [" not in built["notes.md"].decode() and len(built["notes.md"]) > 200

    check, again = re.findall(r"```sh\n(sha256sum .*)\n(\w+=\S+ tools/.*)\n```", (tshark.ROOT / "docs/ci.md").read_text())[0]
    (repository / "dist" / f"yapp-profile-{TAG[1:]}.zip").unlink()  # not everything was downloaded
    assert run(repository / "dist", "bash", "-c", check).returncode == 0
    viewer = "0" * 64 + f"  yapp-viewer-{TAG[1:]}.zip\n"  # which the workflow adds
    (repository / "SHA256SUMS").write_bytes(built["SHA256SUMS"] + viewer.encode())
    assert run(repository, "bash", "-c", again).returncode == 0
    one = hashlib.sha256(built[f"yapp-{TAG[1:]}.zip"]).hexdigest()
    (folder / "sums").write_text(done.stdout.replace(one, "0" * 64))
    done = run(repository, "tools/release.sh", TAG, folder / "sums")
    assert done.returncode == 1 and "another machine differs" in done.stderr


def test_a_tag_of_another_version(repository):
    done = run(repository, "tools/release.sh", "v0.1")
    assert done.returncode == 1 and f"the tag is v0.1, the version {TAG}" in done.stderr
    git(repository, ["tag", "-d", TAG])
    done = run(repository, "tools/release.sh", TAG)
    assert done.returncode == 1 and f"there is no tag {TAG}" in done.stderr


def test_a_release_names_its_owner(folder):
    """Every page and job has the word from one variable; no other word of the repository is the same."""
    listed = {}
    for owner in ("", "acme-1"):
        done = run(tshark.ROOT, PYTHON, "tools/dist.py", folder / f"dist{owner}", SOURCE_DATE_EPOCH="1700000000", YAPP_OWNER=owner)
        assert done.returncode == 0, done.stderr
        with zipfile.ZipFile(folder / f"dist{owner}/yapp-{TAG[1:]}.zip") as archive:
            listed[owner] = {name: archive.read(name).decode("utf-8", "replace") for name in archive.namelist()}
    named = [name for name, text in listed[""].items() if re.search(r"\bOWNER\b", text) and not name.endswith(".py")]
    assert {"yapp/action.yml", "yapp/docs/ci.md", "yapp/ci/gitlab-yapp.yml", "yapp/SECURITY.md"} <= set(named)
    for name in named:
        assert listed["acme-1"][name] == re.sub(r"\bOWNER\b", "acme-1", listed[""][name]), name
    assert "uses: acme-1/yapp@v" in listed["acme-1"]["yapp/docs/ci.md"]


def test_the_workflow_calls_it():
    text = (tshark.ROOT / ".github/workflows/release.yml").read_text()
    assert text.count('run: tools/release.sh "$GITHUB_REF_NAME"') == 2 and " test\n" in text and 'tags: ["v*"]' in text


WORKFLOWS = sorted((tshark.ROOT / ".github/workflows").glob("*.yml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_are_pinned_and_may_only_read(path):
    text = path.read_text()
    used = re.findall(r"uses: (\S+)(.*)", text)
    assert used
    for action, behind in used:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", action) and re.fullmatch(r" # v[\d.]+", behind), action
    assert re.search(r"^permissions:\n  contents: read\n", text, re.M)
    writing = re.findall(r"^ +(\S+): write", text, re.M)
    allowed = {"release": ["contents", "id-token", "attestations"], "viewer": ["pages", "id-token"]}
    assert writing == allowed.get(path.stem, [])
