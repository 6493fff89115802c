"""Writes the report of an evaluation.

Each table is written as CSV, LaTeX and Markdown, each picture as PNG, and all of it on index.html and in report.md.
evaluate.py and `python -m training.report` call it.
"""

from __future__ import annotations

import html
import importlib.util
import shutil
from dataclasses import replace
from pathlib import Path
from typing import List, Sequence, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import write_bytes
from training.common.folders import make_folder
from training.common.provenance import sentences
from training.evaluation.trials import PROTOCOLS
from training.report import drives, figures, paper
from training.report.data import Results
from training.report.table import Table
from training.report.tables import PAPER
from training.report.tables_more import MORE, planners

FOLDER = "report"
CURVES = ("learning_curves.png", "curves.png")  # what a training run calls its picture

TIMES = (
    "Traversal time against world index, ordered by %s's time, with linear fits (the paper's figure of "
    "training and test environments)."
)
PROFILE = (
    "Parameters of %s along %s: regions by the room around the robot; dotted: θ₀ (the paper's parameter profiles)."
)

STYLE = """body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1180px;padding:0 1em;color:#222}
table{border-collapse:collapse;font-size:13px;margin:.6em 0}
th,td{padding:3px 9px;text-align:right;border-bottom:1px solid #ddd}td{white-space:nowrap}
th{border-bottom:2px solid #888;vertical-align:bottom}th:first-child,td:first-child{text-align:left}
#methods+table td,#methods+table th{text-align:left;white-space:normal}
.note{font-size:12.5px;color:#555;margin:.3em 0;max-width:900px}
img{max-width:100%;border:1px solid #eee;margin:.4em 0}h1{font-size:24px}h2{font-size:18px;margin-top:1.8em}"""


def write(folder, training: str = "", beside: Sequence[str] = (), joined: Sequence[str] = ()) -> str:
    """Write folder/report/ and return the path of its index.html.

    Args:
        folder: the folder of an evaluation.
        training: a training run whose learning curves are shown; empty for none.
        beside: folders of further evaluations, for instance with another planner, for one table over all of them.
        joined: folders of evaluations of the same methods in other worlds, or of other methods in the same worlds,
            which all tables count in.

    Raises:
        ApplrError: trials or plotting library are missing, or joined evaluations do not fit together.
        StorageError: the folder cannot be read or written.
    """
    results = Results(folder, joined=joined)
    out = make_folder(results.folder / FOLDER)
    label = _label(results)
    made = [make(results) for make in PAPER + MORE]
    made = [replace(table, title="%s (%s)" % (table.title, label)) for table in made]
    if beside:
        made.append(planners([results, *map(Results, beside)]))
    tables = [table for table in made if table.rows]
    pictures = _pictures(results, out, training)
    for table in tables:
        for ending, text in (("csv", table.csv()), ("tex", table.latex()), ("md", table.markdown())):
            write_bytes(out / ("%s.%s" % (table.name, ending)), text.encode())
    title, facts = _facts(results)
    if drives.write(results, out, title):
        facts.append("%s shows the drives of all methods side by side, world by world, as an animation." % drives.FILE)
    write_bytes(out / "report.md", _markdown(title, facts, tables, pictures).encode())
    write_bytes(out / "index.html", _html(title, facts, tables, pictures).encode())
    return str(out / "index.html")


def _label(results: Results) -> str:
    """What every caption says: the methods and the planner."""
    names = [m for m in results.methods if "-without-" not in m]
    more = len(results.methods) - len(names)
    methods = ", ".join(names) + (" and %d with one parameter held" % more if more else "")
    return "methods %s; planner %s" % (methods, results.planner)


def _pictures(results: Results, out: Path, training: str) -> List[Tuple[str, str]]:
    """The pictures as a list of (file, caption)."""
    if importlib.util.find_spec("matplotlib") is None:
        raise ApplrError("the report's pictures need matplotlib; install it, or give --no-report")
    label = _label(results)
    found = [(figures.times(results, out), "%s (%s)" % (TIMES % results.baseline, label))]
    for world in figures.chosen(results):
        found.append((figures.paths(results, out, world), "Driven paths over the map of %s (%s)" % (world, label)))
        deciding = [m for m in results.methods if not _fixed(results, m)][:3]
        found += [
            (figures.profile(results, out, world, m), "%s (%s)" % (PROFILE % (m, world), label)) for m in deciding
        ]
    if training:
        found.append((_curves(Path(training), out), "Learning curves of %s. %s" % (training, paper.NOISE_SLIP)))
    return [(file, caption) for file, caption in found if file]


def _fixed(results: Results, method: str) -> bool:
    return isinstance(results.settings.get("methods", {}).get(method, {}).get("parameters"), dict)


def _curves(run: Path, out: Path) -> str:
    for name in CURVES:
        if (run / name).is_file():
            shutil.copyfile(run / name, out / "learning_curves.png")
            return "learning_curves.png"
    raise ApplrError("%s holds no learning curves (%s); give the folder of a training run" % (run, ", ".join(CURVES)))


def _facts(results: Results) -> Tuple[str, List[str]]:
    s = results.settings
    per = sorted({len(c.success) for cells in results.cells.values() for c in cells.values()})
    trials = str(per[0]) if len(per) == 1 else "%d to %d" % (per[0], per[-1])
    facts = [
        "%d trials: %d worlds × %d methods × %s trials. Simulator: %s, ground %s. Planner: %s."
        % (
            results.count,
            len(results.worlds),
            len(results.methods),
            trials,
            s.get("simulator", "not recorded"),
            s.get("ground", "not recorded"),
            results.planner,
        ),
    ]
    if s.get("protocol") in PROTOCOLS:
        facts.append("Protocol %s. %s" % (s["protocol"], PROTOCOLS[s["protocol"]].sentence))
    if "wall_s" in s:
        facts.append(
            "Wall time %s with %s workers; base seed %s, the same seeds for every method."
            % (_clock(s["wall_s"]), s.get("workers", "?"), s.get("seed", "?"))
        )
    facts += sentences(s.get("provenance", []))
    return "APPLR: evaluation of %s" % ", ".join(results.methods), facts


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return "%d h %02d min" % (hours, minutes) if hours else "%d min %02d s" % (minutes, rest)


def _markdown(title: str, facts: List[str], tables: List[Table], pictures) -> str:
    return "# %s\n\n%s\n\n%s\n%s" % (
        title,
        "\n".join(facts),
        "\n".join(t.markdown() for t in tables),
        "".join("\n![%s](%s)\n" % (caption, file) for file, caption in pictures),
    )


def _html(title: str, facts: List[str], tables: List[Table], pictures) -> str:
    link = '<a href="%s">%s</a>' % (drives.FILE, drives.FILE)
    body = ["<h1>%s</h1>" % html.escape(title)]
    body += ["<p>%s</p>" % html.escape(f).replace(drives.FILE, link) for f in facts]
    body += [t.html() for t in tables]
    for file, caption in pictures:
        said = html.escape(caption)
        body.append('<h2>%s</h2><img src="%s" alt="%s">' % (said, html.escape(file), said))
    page = (
        [
            "<!doctype html><html lang=en><head><meta charset=utf-8>",
            "<title>%s</title>" % html.escape(title),
            "<style>%s</style></head><body>" % STYLE,
        ]
        + body
        + ["</body></html>"]
    )
    return "\n".join(page) + "\n"
