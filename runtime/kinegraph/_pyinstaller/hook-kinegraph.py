"""What PyInstaller cannot see: the default bundle, and modules that are imported by name."""

from PyInstaller.utils.hooks import collect_data_files, collect_submodules

datas = collect_data_files("kinegraph", subdir="bundles")
hiddenimports = collect_submodules("kinegraph.formats")
