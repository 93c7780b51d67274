#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Installs YAPP for Wireshark from the repository: install.py --help.  The program is src/yapp_tables/install.py."""
import pathlib
import runpy

runpy.run_path(str(pathlib.Path(__file__).resolve().parent / "src/yapp_tables/install.py"), run_name="__main__")
