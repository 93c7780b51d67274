# SPDX-License-Identifier: GPL-2.0-or-later
"""Builds the wheel of yapp-tables, with the plugin, the live ports and the profile in it: what pip asks for (PEP 517, 660).

A wheel is a zip with three lists.  Written here it needs no other package and no network, and the same files give the same
bytes, whoever builds it with whatever pip: nothing is compressed, since each zlib packs in its own way.
"""
import base64
import hashlib
import os
import pathlib
import sys
import time
import tomllib
import zipfile

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import bundle  # noqa: E402

SOURCE = HERE / "src"
OLDEST = "946684800"  # the year 2000: a zip knows no time before 1980


def project():
    with open(HERE / "pyproject.toml", "rb") as file:
        return tomllib.load(file)["project"]


def distribution(about):
    """The start of all names: yapp_tables-2.1.0."""
    return f"{about['name'].replace('-', '_')}-{about['version']}"


def requirements(about):
    for need in about["dependencies"]:
        yield f"Requires-Dist: {need}"
    for extra, needs in about["optional-dependencies"].items():
        yield f"Provides-Extra: {extra}"
        for need in needs:
            yield f"Requires-Dist: {need}; extra == '{extra}'"


def metadata(about):
    """The file METADATA."""
    lines = ["Metadata-Version: 2.4", f"Name: {about['name']}", f"Version: {about['version']}",
             f"Summary: {about['description']}", f"License-Expression: {about['license']}",
             f"Requires-Python: {about['requires-python']}", *requirements(about), "Description-Content-Type: text/markdown"]
    return "\n".join(lines) + "\n\n" + (HERE / about["readme"]).read_text(encoding="utf-8")


def information(about):
    """What stands in the wheel's own folder, but for the list of all files."""
    scripts = "".join(f"{name} = {place}\n" for name, place in about["scripts"].items())
    return {"METADATA": metadata(about), "entry_points.txt": f"[console_scripts]\n{scripts}",
            "WHEEL": "Wheel-Version: 1.0\nGenerator: yapp\nRoot-Is-Purelib: true\nTag: py3-none-any\n"}


def package():
    """{ place in the wheel: bytes } of the package and of what it installs."""
    files = {path.relative_to(SOURCE).as_posix(): path.read_bytes()
             for path in SOURCE.glob("yapp_tables/*") if path.is_file()}
    return {**files, **{f"yapp_tables/plugin/{name}": content for name, content in bundle.installed(HERE.parent).items()}}


def write_zip(path, files):
    """Writes { place: bytes }: the same bytes for the same files.  Programs are those that begin with #!."""
    when = time.gmtime(int(os.environ.get("SOURCE_DATE_EPOCH") or OLDEST))
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in sorted(files.items()):
            entry = zipfile.ZipInfo(name, when[:6])
            entry.create_system = 3
            entry.external_attr = (0o100755 if content.startswith(b"#!") else 0o100644) << 16
            archive.writestr(entry, content)


def digest(content):
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()


def write_wheel(folder, files):
    """Writes the wheel that has these files; returns its name."""
    about = project()
    own = f"{distribution(about)}.dist-info"
    files = {**files, **{f"{own}/{name}": text.encode() for name, text in information(about).items()}}
    record = [f"{name},sha256={digest(content)},{len(content)}" for name, content in sorted(files.items())]
    files[f"{own}/RECORD"] = "\n".join([*record, f"{own}/RECORD,,", ""]).encode()
    name = f"{distribution(about)}-py3-none-any.whl"
    write_zip(pathlib.Path(folder) / name, files)
    return name


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    """A hook of pip's."""
    return write_wheel(wheel_directory, package())


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    """A hook of pip's, for pip install -e: the package is found where it lies."""
    return write_wheel(wheel_directory, {"yapp_tables.pth": f"{SOURCE}\n".encode()})


def build_sdist(sdist_directory, config_settings=None):
    """A hook of pip's that only uploads to an index need."""
    raise NotImplementedError("there is no source distribution: build a wheel from the repository")
