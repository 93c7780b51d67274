# SPDX-License-Identifier: GPL-2.0-or-later
"""Put the plugin, the live ports and the profile into the package: what hatchling calls for each wheel and sdist.

In the repository they come from bundle.py. A source distribution has them already.
"""
import pathlib
import sys
import tempfile

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PLACE = "yapp_tables/plugin"


class CustomBuildHook(BuildHookInterface):
    """Add yapp_tables/plugin."""

    def initialize(self, version, build_data):
        """Hand the files to hatchling; an editable installation finds them in the repository."""
        top = pathlib.Path(self.root).parent
        if version == "editable" or not (top / "yapp.lua").is_file():
            return
        sys.path.insert(0, self.root)
        import bundle
        self.folder = tempfile.TemporaryDirectory()
        prefix = "src/" if self.target_name == "sdist" else ""
        for name, content in bundle.installed(top).items():
            path = pathlib.Path(self.folder.name, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            path.chmod(0o755 if content.startswith(b"#!") else 0o644)
            build_data["force_include"][str(path)] = f"{prefix}{PLACE}/{name}"

    def finalize(self, version, build_data, artifact_path):
        """Remove the copies."""
        if hasattr(self, "folder"):
            self.folder.cleanup()
