"""Collect what PyInstaller cannot see: the default bundle, the viewer's files, and formats imported by name."""

from PyInstaller.utils.hooks import collect_data_files, collect_submodules

datas = collect_data_files("kinegraph", subdir="bundles") + collect_data_files("kinegraph", subdir="viewer")
hiddenimports = collect_submodules("kinegraph.formats")
