"""Open the labels after the verdicts: ``python score.py DIR [--json F]`` runs the diagnosis on every file and prints who was right."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

Json = dict[str, Any]


def diagnose(path: Path, timeout: float) -> Json:
    """Answer of the tool to one file; a verdict ``failed`` if it gave none."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, "-m", "gyro_calib.cli", "diagnose", str(path), "--json", str(answer)]
        start = time.monotonic()
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
            error = done.stderr.strip()[-300:]
        except subprocess.TimeoutExpired:
            error = f"no answer in {timeout:.0f} s"
        result: Json = json.loads(answer.read_text()) if answer.exists() else {"verdict": "failed", "error": error}
        result["seconds"] = time.monotonic() - start
        return result


def _names(effect: Json) -> set[str]:
    return {effect["name"], *effect.get("group", [])}


def _truth(effect: Json) -> set[str]:
    """Names that are right: the registry's, what physics makes the same everywhere, and here alone (near.py)."""
    return {name for name in (effect["registry"], *effect["group"], *effect.get("inseparable", [])) if name}


def is_right(label: Json, answer: Json) -> bool:
    """Whether a verdict is the label's."""
    verdict, named = answer["verdict"], answer.get("effects", [])
    if label["stratum"] == "healthy":
        return bool(verdict == "none")
    # of some strangers the registry has a name since
    if label["stratum"] == "stranger" and not label["effects"][0]["registry"]:
        return bool(verdict == "unknown")
    if verdict != "effects" or not named:
        return False
    if label["stratum"] != "pair":
        return bool(_truth(label["effects"][0]) & _names(named[0]))
    if len(named) != len(label["effects"]):
        return False
    truths, answers = [_truth(e) for e in label["effects"]], [_names(e) for e in named]
    return any(all(t & a for t, a in zip(truths, order, strict=True)) for order in (answers, answers[::-1]))


def _said(answer: Json) -> str:
    parts = []
    for effect in answer.get("effects", []):
        others = [g for g in effect.get("group", []) if g != effect["name"]]
        parts.append(effect["name"] + (f" ({', '.join(others)})" if others else ""))
    unknown = answer.get("unknown")
    if answer["verdict"] == "unknown" and unknown:
        parts.append(f"[{unknown.get('location')}: {unknown.get('form')}; near {unknown.get('nearest')}]")
    return "; ".join(parts) or str(answer.get("error", ""))


def _rms(answer: Json, when: str) -> str:
    value = answer.get("gap", {}).get(when, {}).get("rms_over_noise")
    return "" if value is None else f"{value:.3f}"


def _row(name: str, label: Json, answer: Json) -> Json:
    return {
        "campaign": name,
        "kind": label["kind"],
        "stratum": label["stratum"],
        "poor": label.get("poor"),
        "truth": [e["name"] for e in label["effects"]],
        "snr": [e["snr"] for e in label["effects"]],
        "verdict": answer["verdict"],
        "said": _said(answer),
        "rms": [_rms(answer, "before"), _rms(answer, "after")],
        "right": is_right(label, answer),
        "fair": label["stratum"] != "stranger" or not any(e.get("inseparable") for e in label["effects"]),
        "seconds": round(answer["seconds"], 1),
    }


def _check_seal(folder: Path, name: str, text: str) -> None:
    seals = folder / "labels.sha256"
    if seals.exists():
        sealed = {path: digest for digest, path in (line.split() for line in seals.read_text().splitlines() if line.strip())}
        if sealed.get(f"labels/{name}.json") != hashlib.sha256(text.encode()).hexdigest():
            raise SystemExit(f"label {name} is not the one that was sealed")


def _add_more(folder: Path, name: str, label: Json) -> None:
    """Take in what near.py found, if it was run."""
    more = folder / "labels_more" / f"{name}.json"
    if more.exists():
        for effect, extra in zip(label["effects"], json.loads(more.read_text()), strict=True):
            effect["inseparable"] = extra["inseparable"]
            effect["snr"] = min(effect["snr"], extra["snr_with_wander"])


def _print(row: Json) -> None:
    truth = " + ".join(f"{n} ({s:g})" for n, s in zip(row["truth"], row["snr"], strict=True)) or "healthy"
    stranger = "" if row["stratum"] != "stranger" else " stranger" if row["fair"] else " stranger, but like a registered effect here"
    poor = f" [{row['poor']}]" if row["poor"] else ""
    print(f"{row['campaign']} {row['kind']:<4} {'right' if row['right'] else 'WRONG':<5} {truth}{stranger}{poor}", flush=True)
    print(f"       -> {row['verdict']}: {row['said']}  rms {row['rms'][0]} -> {row['rms'][1]}, {row['seconds']:g} s", flush=True)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--timeout", type=float, default=1800.0)
    parser.add_argument("--only", default="", help="names of campaigns, separated by commas")
    args = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    wanted = set(filter(None, args.only.split(",")))
    paths = [p for p in sorted((args.folder / "data").glob("*.h5")) if not wanted or p.stem in wanted]
    # every verdict before any label is opened
    answers = {}
    for path in paths:
        answers[path.stem] = diagnose(path, args.timeout)
        print(f"{path.stem}: {answers[path.stem]['seconds']:.0f} s", file=sys.stderr, flush=True)
    rows = []
    for name, answer in answers.items():
        text = (args.folder / "labels" / f"{name}.json").read_text()
        _check_seal(args.folder, name, text)
        label = json.loads(text)
        _add_more(args.folder, name, label)
        rows.append(_row(name, label, answer))
        _print(rows[-1])
    print()
    totals = {}
    for stratum in ("healthy", "single", "stranger", "pair"):
        here = [r for r in rows if r["stratum"] == stratum]
        if here:
            totals[stratum] = {"right": sum(r["right"] for r in here), "of": len(here)}
            print(f"{stratum:<9} {totals[stratum]['right']:3d} of {len(here)}")
    unfair = [r for r in rows if not r["fair"]]
    if unfair:
        print(f"  of these {len(unfair)} strangers that a registered effect would explain here, {sum(r['right'] for r in unfair)} right")
    print(f"{'all':<9} {sum(r['right'] for r in rows):3d} of {len(rows)}")
    if args.json:
        args.json.write_text(json.dumps({"campaigns": rows, "totals": totals, "answers": answers}, indent=1, default=str))
    return 0


if __name__ == "__main__":
    sys.exit(main())
