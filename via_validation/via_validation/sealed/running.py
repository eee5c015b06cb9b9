"""Run a diagnosis command on every case, each in a separate process that gets only the case's folder."""

from __future__ import annotations

import json
import shlex
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

from via_core.errors import ViaError

from via_validation.sealed.sealing import DEVICE, logs_in, names_in

RUNS = "runs.json"


@dataclass(frozen=True)
class Ran:
    """One diagnosis: exit code (None: time limit exceeded), seconds, and the end of its error output if it failed."""

    name: str
    code: int | None
    seconds: float
    said: str = ""


def command_words(template: str, **paths: Path | list[Path]) -> list[str]:
    """The words of a command after its {placeholders} are replaced by paths; a list of paths becomes several words.

    Raises ViaError for an unknown placeholder.
    """
    several = {f"{{{name}}}": path for name, path in paths.items() if isinstance(path, list)}
    single = {name: str(path) for name, path in paths.items() if not isinstance(path, list)}
    try:
        words = [several.get(word, [word]) for word in shlex.split(template)]
        return [str(w) if isinstance(w, Path) else w.format(**single) for each in words for w in each]
    except (KeyError, IndexError, ValueError) as error:
        raise ViaError(
            f"command '{template}' cannot be expanded ({error}); placeholders are {{{'}, {'.join(paths)}}}"
        ) from None


def run_cases(
    cases: Path, results: Path, template: str, patience: float, processes: int, progress: Callable[[Ran], None]
) -> list[Ran]:
    """Diagnose every case; report and effects file of `case_000` are results/case_000.json and .yaml.

    Cases with a report are skipped, so that an interrupted run continues where it stopped. `patience`: time limit of a
    case [s].
    """
    results.mkdir(parents=True, exist_ok=True)
    runs_file = results / RUNS
    before = json.loads(runs_file.read_text(encoding="utf-8")) if runs_file.exists() else []
    ran = {each["name"]: Ran(**each) for each in before}
    # An interruption can leave a report whose run is not in the list.
    todo = [name for name in names_in(cases) if name not in ran or not (results / f"{name}.json").exists()]
    with ThreadPoolExecutor(processes) as pool:
        jobs = [pool.submit(_diagnosed, cases / name, results, template, patience) for name in todo]
        try:
            for job in as_completed(jobs):
                done = job.result()
                ran[done.name] = done
                progress(done)
                listed = [asdict(ran[name]) for name in sorted(ran)]
                runs_file.write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # running jobs finish, no other starts
            raise
    return [ran[name] for name in sorted(ran)]


def _diagnosed(folder: Path, results: Path, template: str, patience: float) -> Ran:
    name = folder.name
    words = command_words(
        template,
        bag=[log.resolve() for log in logs_in(folder)],
        device=(folder / DEVICE).resolve(),
        json=(results / f"{name}.json").resolve(),
        effects=(results / f"{name}.yaml").resolve(),
    )
    begin = time.perf_counter()
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=patience, cwd=results, check=False)
    except subprocess.TimeoutExpired:
        return Ran(name, None, patience, f"took longer than {patience:g} s")
    except OSError as error:
        raise ViaError(f"command '{words[0]}': {error.strerror}") from None
    seconds = time.perf_counter() - begin
    return Ran(name, done.returncode, round(seconds, 2), done.stderr.strip()[-400:] if done.returncode else "")
