"""Deliberate faults: each breaks one promise in one place, and names the tests that must notice it.

A fault replaces exact text, so that it cannot quietly miss when the code changes: text that is not there exactly once
is an error of `run.py`.

Above 500 lines because every promise has several faults, and each names its text, its change and its tests.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """One change of the runtime that a test must notice."""

    promise: int
    """Number of the promise it breaks (SECURITY.md)."""
    what: str
    file: str
    """Below runtime/kinegraph."""
    old: str
    new: str
    tests: str
    """Arguments of pytest: files, below tests, and -k with names."""


INTEGRITY = "promises/test_integrity.py"
CONTAINMENT = "promises/test_containment.py"
INERT = "promises/test_inert_data.py"
BOUNDED = "promises/test_bounded_input.py"
DETERMINISM = "promises/test_determinism.py"
THREADS = "promises/test_threads.py"
MEMORY = "promises/test_flat_memory.py"
WHOLE = "promises/test_all_or_nothing.py"
QUIET = "promises/test_lean_and_quiet.py"

_DIGEST = "    if hashlib.sha256(data).hexdigest() != entry.sha256:"
_NAN = "    for values in results:\n        require_finite(values, model)"


def _unchecked(model: str) -> str:
    return _NAN.replace("require_finite", f'model == "{model}" or require_finite')


FAULTS: tuple[Fault, ...] = (
    # 1. Integrity
    Fault(
        1,
        "skeleton space may lack graphs",
        "bundle/manifest_validation.py",
        "    _require(present == FRAME_FILES, ",
        "    _require(True, ",
        "runtime/test_manifest.py -k skeleton_space_is_optional",
    ),
    Fault(1, "no hash is compared", "bundle/reader.py", _DIGEST, "    if False:", f"{INTEGRITY} -k stops_the_pipeline"),
    Fault(
        1,
        "hashes of files below 4 KiB alone are compared",
        "bundle/reader.py",
        _DIGEST,
        _DIGEST.replace("if ", "if len(data) < 4096 and "),
        f"{INTEGRITY} -k stops_the_pipeline",
    ),
    Fault(
        1,
        "files are read again after hashing",
        "bundle/reader.py",
        "MappingProxyType(files), tables, vocabulary, shared)",
        "{name: (folder / name).read_bytes() for name in files}, tables, vocabulary, shared)",
        f"{INTEGRITY} -k bytes_that_are_hashed",
    ),
    Fault(
        1,
        "optional graphs are not hashed",
        "bundle/reader.py",
        "data = _read_listed(_place(self.path, name, self.shared), name, self.manifest.files[name])",
        "data = (self.path / name).read_bytes()",
        f"{INTEGRITY} -k optional_graph",
    ),
    Fault(
        1,
        "large graphs are not hashed",
        "bundle/sessions.py",
        "        return open_session(data or bundle.read_later(contract.file), contract, settings)",
        "        return open_session(data or (bundle.path / contract.file).read_bytes(), contract, settings)",
        f"{INTEGRITY} -k large_graph",
    ),
    Fault(
        8,
        "large graphs are read together",
        "bundle/reader.py",
        "if manifest.files[name].bytes >= LARGE_FILE}",
        "if False}",
        f"{INTEGRITY} -k large_graph",
    ),
    Fault(
        1,
        "files that are not listed are ignored",
        "bundle/reader.py",
        "    for name in sorted(present - listed):",
        "    for name in ():",
        f"{INTEGRITY} -k extra",
    ),
    # 2. Containment
    Fault(
        2,
        "O_NOFOLLOW is dropped",
        "bundle/reader.py",
        '    | getattr(os, "O_NOFOLLOW", 0)\n',
        "",
        f"{CONTAINMENT} -k after_the_look",
    ),
    Fault(
        2,
        "links are not looked for",
        "bundle/reader.py",
        "if path.is_symlink():",
        "if False:",
        f"{CONTAINMENT} -k refused_unread",
    ),
    Fault(
        2,
        "external data is allowed in optional graphs",
        "bundle/reader.py",
        "        check_self_contained(data, name)\n        return data",
        "        return data",
        f"{CONTAINMENT} -k tensors_outside",
    ),
    Fault(
        2,
        "devices and pipes are read",
        "bundle/reader.py",
        "if not stat.S_ISREG(status.st_mode):",
        "if False:",
        f"{CONTAINMENT} -k regular_files",
    ),
    # 3. Inert data
    Fault(
        3,
        "verify ignores operators of optional graphs",
        "bundle/verify.py",
        "    data = bundle.read_graph(name)",
        "    if name not in bundle.files:\n        return 0\n    data = bundle.read_graph(name)",
        f"{INERT} -k not_listed",
    ),
    Fault(
        3,
        "parser.bin configures the parser",
        "text/dependency.py",
        'exclude=["meta", "config", "config.cfg", "meta.json"]',
        "exclude=[]",
        f"{INERT} -k takes_weights",
    ),
    Fault(
        3,
        "arrays may be pickled",
        "archives.py",
        "    content = io.BytesIO(archive.read(entry))\n",
        "    content = io.BytesIO(archive.read(entry))\n    return np.load(content, allow_pickle=True)\n",
        f"{INERT} runtime/test_bundle_contents.py -k run_data",
    ),
    # 4. Bounded input
    Fault(
        4,
        "members unpack to any size",
        "archives.py",
        "    if entry.file_size > most:",
        "    if False:",
        "runtime/test_vocabulary_file.py -k broken",
    ),
    Fault(
        4,
        "any number of members",
        "archives.py",
        "data.count(_DIRECTORY_ENTRY) > MAX_MEMBERS",
        "False",
        f"{BOUNDED} -k members",
    ),
    Fault(
        4,
        "a run has any number of rows",
        "concepts.py",
        "        if len(self.graphs) > MAX_ROWS:",
        "        if False:",
        f"{BOUNDED} -k more_rows",
    ),
    Fault(
        4,
        "weights may nearly cancel",
        "concepts.py",
        "if total < MIN_SUM or size > MAX_RATIO * total:",
        "if total == 0:",
        "runtime/test_compose.py",
    ),
    Fault(
        4,
        "files of constraints of any size",
        "formats/constraints_json.py",
        "    if len(data) > MAX_BYTES:",
        "    if False:",
        "runtime/test_constraints_json.py -k refused",
    ),
    Fault(
        4,
        "files of constraints of any number of lists",
        "formats/constraints_json.py",
        'data.count(b"[") + data.count(b"{") > MAX_LISTS',
        "False",
        "runtime/test_constraints_json.py -k refused",
    ),
    Fault(
        4,
        "constraints with NaN",
        "constraint_values.py",
        "    if not np.isfinite(copy).all():",
        "    if False:",
        "runtime/test_constraints.py -k wrong_values",
    ),
    Fault(
        4,
        "keyframes whose rotations are none",
        "constraint_values.py",
        "    if wrong.any():",
        "    if False:",
        "runtime/test_constraints.py -k wrong_values",
    ),
    Fault(
        4,
        "constraints that a bundle has no graphs for",
        "constrained_denoising.py",
        "    if not sampler.sessions.decoder_gradients:",
        "    if False:",
        "runtime/test_constrained_clips.py -k without_gradients",
    ),
    Fault(
        4,
        "graphs of gradients that are none",
        "bundle/onnx_split.py",
        "        if tensor.encode() not in given:",
        "        if False:",
        "runtime/test_onnx_split.py -k refused",
    ),
    Fault(
        4,
        "edits that keep what is no part",
        "keeping.py",
        "            if item not in PARTS:",
        "            if False:",
        "runtime/test_clip_editing.py -k bad_edits",
    ),
    Fault(
        4,
        "edits that keep all of a clip",
        "keeping.py",
        "    if (kept.world | kept.relative).all():",
        "    if False:",
        "runtime/test_clip_editing.py -k bad_edits",
    ),
    Fault(
        4,
        "skeleton space lets a hand go",
        "frame_inpainting.py",
        "        if self.reached is not None:",
        "        if False:",
        "runtime/test_frame_inpainting.py -k hand_is_held",
    ),
    Fault(
        4,
        "what is known is let go",
        "frame_inpainting.py",
        "        held = np.where(self.mask, self.tokens, clean)",
        "        held = clean",
        "runtime/test_frame_inpainting.py -k loop_of_mdm",
    ),
    Fault(
        4,
        "a timeline in skeleton space lets its constraints go",
        "frame_timeline.py",
        "        if hold is None:\n            return predict",
        "        if True:\n            return predict",
        "runtime/test_frame_inpainting.py -k timeline_walks_a_path",
    ),
    Fault(
        4,
        "what is held moves with the velocities around it",
        "motion/fusion.py",
        "HELD, 1.0)",
        "1.0, 1.0)",
        "runtime/test_fusion.py -k what_is_known",
    ),
    Fault(
        6,
        "a sequence continues from anywhere",
        "pipeline.py",
        "        wanted = None if begin is None else begin_in(begin, self.sampler)",
        "        wanted = None",
        "runtime/test_sequence.py -k continue_from",
    ),
    Fault(
        6,
        "constraints of no weight pull",
        "constrained_denoising.py",
        "        return self.weight > 0 and (self.kept",
        "        return (self.kept",
        "runtime/test_constrained_clips.py -k no_weight",
    ),
    Fault(
        9,
        "nobody stops the descent under constraints",
        "constrained_denoising.py",
        "        if is_stop(self.on_step(info)):",
        "        if self.on_step(info) is None and False:",
        "runtime/test_constrained_clips.py -k any_can_be_the_last",
    ),
    Fault(
        4,
        "constraints after the end of the clip",
        "feasibility.py",
        "    if last > frames / fps + 1e-6:",
        "    if False:",
        "runtime/test_constraints.py -k cannot_be_meant",
    ),
    Fault(
        4,
        "constraints that contradict each other",
        "feasibility.py",
        "if source != key.source and abs(other - value) > SAME:",
        "if False:",
        "runtime/test_constraints.py -k cannot_be_meant",
    ),
    Fault(
        4,
        "strict lets what nobody can do pass",
        "feasibility.py",
        "    if strict and notes:",
        "    if False:",
        "runtime/test_constraints.py -k refused_when_strict",
    ),
    Fault(
        4,
        "captions of any length",
        "text/parser.py",
        "    if len(caption) > MAX_TEXT:",
        "    if False:",
        f"{BOUNDED} -k long_captions",
    ),
    Fault(
        4,
        "any number of word pieces",
        "text/tokenizer.py",
        "if len(encoding.ids) > self._max_pieces:",
        "if False:",
        "runtime/test_tokens.py",
    ),
    Fault(
        4,
        "numbers of 400 digits overflow",
        "validation.py",
        "except OverflowError:  #",
        "except ZeroDivisionError:  #",
        f"{BOUNDED} -k 'public and concept'",
    ),
    Fault(
        4,
        "messages show values whole",
        "validation.py",
        '    return f"a value of type {type(value).__name__}"',
        "    return repr(value)",
        f"{BOUNDED} -k 'public and action'",
    ),
    Fault(
        4,
        "messages of manifests show values whole",
        "bundle/strict_json.py",
        'return f"{name} {short_repr(value)}" if isinstance(value, str | int | float) else name',
        'return f"{name} {str(value)[:40]}"',
        f"{BOUNDED} -k nested",
    ),
    Fault(
        4,
        "any number of characters is read at once",
        "playground/guards.py",
        "if self._files >= self._limits.files_at_once:",
        "if False:",
        "runtime/test_playground.py -k few_characters",
    ),
    Fault(
        4,
        "a call needs no token",
        "playground/middleware.py",
        'if path != "/" and not hmac.compare_digest(headers.get(b"authorization", b""), expected):',
        "if False:",
        "runtime/test_playground_host.py -k calls_need_the_token",
    ),
    Fault(
        4,
        "a link of another site drives the page",
        "playground/app.py",
        'waits = request.headers.get("sec-fetch-site", "none") not in ("none", "same-origin")',
        "waits = False",
        "runtime/test_playground_security.py -k drives_nothing",
    ),
    Fault(
        4,
        "a character reads files beside it",
        "formats/character_files.py",
        '    if folder is None:\n        raise InvalidInputError(f"it refers',
        '    folder = folder or Path()\n    if False:\n        raise InvalidInputError(f"it refers',
        "runtime/test_playground.py -k characters_are_bounded",
    ),
    Fault(
        9,
        "arms go through stout bodies",
        "motion/retargeting.py",
        "    if shape is not None:",
        "    if False:",
        "runtime/test_clearance.py -k stay_out_of_its_trunk",
    ),
    Fault(
        9,
        "sentences have the seeds of their places, whatever was asked for",
        "options.py",
        "    if offsets is None:\n",
        "    if True:\n",
        "runtime/test_part_memory.py -k only_what_changed",
    ),
    Fault(
        9,
        "times behind the end of a timeline are forgotten",
        "timeline.py",
        "if latest > whole + 1e-6:",
        "if False:",
        "runtime/test_timeline.py -k does_not_fit",
    ),
    Fault(
        8,
        "parts of sequences are kept without end",
        "part_memory.py",
        "while len(self._clips) > self._most or self.bytes > self._most_bytes:",
        "while len(self._clips) > self._most:",
        "runtime/test_part_memory.py -k bounded",
    ),
    Fault(
        6,
        "a remembered part is that of other options",
        "pipeline.py",
        "return (pipeline, part.graph, part.plan, repr(part.options), seed, begins)",
        "return (pipeline, part.graph, part.plan, seed, begins)",
        "runtime/test_part_memory.py -k only_what_changed",
    ),
    Fault(
        9,
        "a span that is no whole sentence is not told",
        "layers.py",
        "if abs(begin - layer.begin) > EXACT or abs(end - layer.end) > EXACT:",
        "if False:",
        "runtime/test_layers.py -k partly_is_told",
    ),
    Fault(
        4,
        "any long clip is bent for a draft",
        "playground/drafts.py",
        "if request.seed is not None and clip.frames <= MAX_FRAMES:",
        "if request.seed is not None:",
        "runtime/test_drafts.py -k few_and_short",
    ),
    # 5. Parity and 6. determinism
    Fault(
        5,
        "guidance is left out",
        "diffusion/sampling.py",
        "return unconditional + np.float32(scale) * (conditional - unconditional)",
        "return conditional",
        "promises/test_parity.py -k golden",
    ),
    Fault(
        6,
        "every parse seeds the global random states",
        "text/parser.py",
        "        parse = self.parse_dependencies(caption)\n",
        "        import random\n\n        import numpy\n\n        random.seed(0), numpy.random.seed(0)\n"
        "        parse = self.parse_dependencies(caption)\n",
        f"{DETERMINISM} -k every_parse",
    ),
    Fault(
        6,
        "importing spaCy draws from the global random state",
        "text/dependency.py",
        "        random.setstate(state)\n",
        "",
        f"{DETERMINISM} -k processes",
    ),
    Fault(
        6,
        "clips of a shared run have one noise",
        "denoising.py",
        "[initial_noise(sample.seed, levels) for sample in options]",
        "[initial_noise(options[0].seed, levels) for sample in options]",
        f"{DETERMINISM} -k neighbours",
    ),
    # 7. Threads
    Fault(
        7,
        "the graph of a call is kept on the pipeline",
        "pipeline.py",
        "        return replace(clip, graph=sentence.graph, notes=(*sentence.notes, *clip.notes))",
        '        return replace(clip, graph=vars(self).get("last", sentence.graph), notes=sentence.notes)\n\n'
        "    def _keep(self, graph: SemanticGraph) -> SemanticGraph:\n"
        '        object.__setattr__(self, "last", graph)\n        return graph\n\n'
        "    def as_graph(self, text: str | SemanticGraph) -> SemanticGraph:\n"
        "        return self._keep(text if isinstance(text, SemanticGraph) else self.parse(text))",
        f"{THREADS} -k 'own_graphs or no_trace'",
    ),
    Fault(
        7,
        "the parser is made without its lock",
        "text/parser.py",
        "        with self._lock:\n            if self._parser is None:",
        "        if True:\n            if self._parser is None:",
        f"{THREADS} -k made_once",
    ),
    Fault(
        7,
        "sentences are parsed without the lock",
        "text/parser.py",
        "with self._lock, self._dependency_parser.forgetting():",
        "with self._dependency_parser.forgetting():",
        f"{THREADS} -k eight",
    ),
    Fault(
        7,
        "a pipeline can be changed",
        "pipeline.py",
        "@dataclass(frozen=True, init=False, eq=False, repr=False)\n",
        "",
        f"{THREADS} -k can_be_set",
    ),
    # 8. Flat memory
    Fault(
        8,
        "1 MB is kept at each decode",
        "decoding.py",
        '    inputs = {"latent": latents, "frame_mask": frame_mask}\n',
        '    inputs = {"latent": latents, "frame_mask": frame_mask}\n    _KEPT.append(np.ones(131072))\n',
        f"{MEMORY} -k any_length",
    ),
    Fault(
        8,
        "spaCy keeps every new word",
        "text/dependency.py",
        "= self._pipeline.memory_zone()",
        '= __import__("contextlib").nullcontext()',
        f"{MEMORY} -k forgotten",
    ),
    # 9. All or nothing, and stoppable
    Fault(
        9,
        "NaN of the decoder passes",
        "bundle/sessions.py",
        _NAN,
        _unchecked("the decoder"),
        f"{WHOLE} -k 'nan-decoder-generate'",
    ),
    Fault(
        9,
        "NaN of the graph encoder passes",
        "bundle/sessions.py",
        _NAN,
        _unchecked("the graph encoder"),
        f"{WHOLE} -k 'nan-graph_encoder-generate'",
    ),
    Fault(
        9,
        "NaN of the context passes",
        "bundle/sessions.py",
        _NAN,
        _unchecked("the context encoder"),
        f"{WHOLE} -k 'nan-context-generate'",
    ),
    Fault(
        9,
        "latents that explode pass",
        "denoising.py",
        '            require_finite(latents, f"step {index + 1} of level {level.name}")\n',
        "",
        f"{WHOLE} -k explodes",
    ),
    Fault(
        9,
        "onnxruntime's errors are not typed",
        "bundle/sessions.py",
        "    except ORT_ERRORS as error:\n        raise ModelError",
        "    except ZeroDivisionError as error:\n        raise ModelError",
        f"{WHOLE} -k onnxruntime_raises",
    ),
    Fault(
        9,
        "memory that ends is not typed",
        "pipeline.py",
        "        except MemoryError as error:",
        "        except ZeroDivisionError as error:",
        f"{WHOLE} -k memory_that_ends",
    ),
    Fault(
        9,
        "panics of the tokenizer are not typed",
        "text/tokenizer.py",
        "        except BaseException as error:\n            raise ModelError",
        "        except Exception as error:\n            raise ModelError",
        f"{WHOLE} -k tokenizer_and_parser",
    ),
    Fault(
        9,
        "files are written under their own name",
        "files.py",
        "    _remove_abandoned(target.parent)\n",
        "    if force:\n        target.write_bytes(data)\n        return\n    _remove_abandoned(target.parent)\n",
        "runtime/test_files.py -k 'cuts_short or full_disk'",
    ),
    Fault(
        9,
        "no sync before the rename",
        "files.py",
        "            os.fsync(file.fileno())\n",
        "",
        f"{WHOLE} -k on_the_disk",
    ),
    Fault(
        9,
        "abandoned files stay",
        "files.py",
        "    _remove_abandoned(target.parent)\n",
        "",
        f"{WHOLE} -k only_abandoned",
    ),
    Fault(
        9,
        "files of living writers are removed",
        "files.py",
        " and _lock(handle, wait=False)",
        "",
        f"{WHOLE} -k only_abandoned",
    ),
    Fault(
        9,
        "on_step is heeded a step late",
        "denoising.py",
        "            if on_step is not None and is_stop(on_step(info)):",
        '            answers = [*locals().get("answers", []), None if on_step is None else on_step(info)]\n'
        "            if len(answers) > 1 and is_stop(answers[-2]):",
        f"{WHOLE} -k 'stops_at_any_step and generate'",
    ),
    Fault(
        9,
        "numpy's False does not stop",
        "diffusion/sampling.py",
        "return isinstance(answer, bool | np.bool_) and not answer",
        "return answer is False",
        f"{WHOLE} -k 'stops_at_any_step and generate'",
    ),
    Fault(
        9,
        "timeouts never end",
        "options.py",
        "if self.timeout is not None and time.monotonic() >= self.end:",
        "if False:",
        f"{WHOLE} -k 'timeout and generate'",
    ),
    Fault(
        9,
        "a sequence has no timeout",
        "pipeline.py",
        "        on_step = deadline.watch(on_step)\n"
        '        lengths = validate_lengths(texts, seconds, MAX_PARTS, "a sequence")',
        '        lengths = validate_lengths(texts, seconds, MAX_PARTS, "a sequence")',
        f"{WHOLE} -k 'timeout and sequence'",
    ),
    # 10. Lean and quiet
    Fault(
        10,
        "an import takes 2 s more",
        "__init__.py",
        "import os\n",
        "import os\nimport time\n\ntime.sleep(2)\n",
        f"{QUIET} -k takes_little",
    ),
    Fault(
        10,
        "an import starts a thread",
        "__init__.py",
        "import os\n",
        "import os\nimport threading\n\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\n",
        f"{QUIET} -k loads_nothing_heavy",
    ),
    Fault(
        10,
        "an import loads the tokenizer",
        "pipeline.py",
        "import onnxruntime\n",
        "import onnxruntime\nimport tokenizers\n",
        f"{QUIET} -k loads_nothing_heavy",
    ),
    Fault(
        10,
        "pools spin between runs",
        "bundle/sessions.py",
        '"session.force_spinning_stop", "1"',
        '"session.force_spinning_stop", "0"',
        "runtime/test_sessions.py -k spin",
    ),
    Fault(
        10,
        "a clip leaves a file",
        "decoding.py",
        '    inputs = {"latent": latents, "frame_mask": frame_mask}\n',
        '    inputs = {"latent": latents, "frame_mask": frame_mask}\n'
        '    __import__("pathlib").Path("/tmp/kinegraph.log").open("a").close()\n',
        f"{QUIET} -k writes_nothing",
    ),
)
