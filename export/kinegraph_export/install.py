"""Install an exported bundle beside those that come with the package, under a name.

    python -m kinegraph_export.install --bundle BUNDLE --name studio

The files that read text go to the folder that installed bundles share (`kinegraph.bundle.reader.SHARED_FILES`); they
must be those that lie there already, so export all bundles from the same assets. The weights for arguments alone may
differ, for they come under the terms of the captions that they were trained on: a bundle then keeps its own. A bundle
of that name is replaced.
"""

from __future__ import annotations

import argparse
import re
import shutil
from pathlib import Path
from typing import Final

from kinegraph.bundle.reader import BUNDLES, MANIFEST, SHARED, SHARED_FILES, Bundle, read_bundle
from kinegraph.errors import InvalidInputError
from kinegraph.files import write_atomically

NAME: Final = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
MAY_DIFFER: Final = frozenset(("arguments.npz",))
"""Shared files of which a bundle may have its own."""


def install_bundle(path: Path, name: str, bundles: Path = BUNDLES) -> Path:
    """Install a bundle; returns its folder.

    Args:
        path: folder of the bundle; every byte is checked first.
        name: by which it will be loaded.
        bundles: folder of the installed bundles.

    Raises:
        BundleError: the bundle is broken, see `read_bundle`.
        InvalidInputError: the name is none, or a shared file differs from the one that is installed.
        OutputError: a file cannot be written.
    """
    if NAME.fullmatch(name) is None or name == SHARED:
        raise InvalidInputError(f"a bundle's name has 1 to 32 of a-z, 0-9, - and _ and is not {SHARED!r}; not {name!r}")
    bundle = read_bundle(path)
    shared = _share_files(bundle, bundles / SHARED)
    folder, staged = bundles / name, bundles / f".{name}"
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    for file in (MANIFEST, *bundle.manifest.files):
        if file not in shared:
            shutil.copyfile(bundle.path / file, staged / file)
    shutil.rmtree(folder, ignore_errors=True)
    staged.rename(folder)
    return folder


def _share_files(bundle: Bundle, shared: Path) -> frozenset[str]:
    """Write the files that read text into the shared folder, and return their names; refuse before any is written."""
    listed = SHARED_FILES & bundle.manifest.files.keys()
    files = {name: bundle.read_graph(name) for name in listed}
    for name in listed:
        if (shared / name).is_file() and (shared / name).read_bytes() != files[name]:
            if name in MAY_DIFFER:
                del files[name]
                continue
            raise InvalidInputError(
                f"{name} differs from the one in {shared}, which other bundles use; export this bundle from the same "
                "assets, or install all bundles anew into an empty folder"
            )
    shared.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        write_atomically(shared / name, data, force=True)
    return frozenset(files)


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.install", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", type=Path, required=True, help="folder of an exported bundle")
    parser.add_argument("--name", required=True, help="name of the installed bundle")
    options = parser.parse_args(argv)
    folder = install_bundle(options.bundle, options.name)
    read_bundle(folder)
    own = " and ".join(sorted(SHARED_FILES & {path.name for path in folder.iterdir()})) or "none"
    print(f"{folder}; files that read text in {folder.parent / SHARED}, its own of them: {own}")


if __name__ == "__main__":
    main()
