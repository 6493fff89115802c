"""Report of an evaluation: each table as CSV, each figure as PNG, and index.html with all of them.

The page begins with a line for each comparison with the baseline. evaluate.py and ./applr tune
write reports.
"""

from __future__ import annotations

import html
import os
from typing import List, Sequence

from tqdm import tqdm

from applr_ros1.common.extras import absent
from applr_ros1.common.files import write_bytes
from training.common.folders import make_folder
from training.evaluate import drives_page, figures
from training.evaluate.stored import Results
from training.evaluate.tables import TABLES, Made
from training.evaluate.verdict import compared

FOLDER = "report"

STYLE = """body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1180px;
padding:0 1em;color:#222}
table{border-collapse:collapse;font-size:13px;margin:.6em 0}
th,td{padding:3px 9px;text-align:right;border-bottom:1px solid #ddd}td{white-space:nowrap}
th{border-bottom:2px solid #888;vertical-align:bottom}th:first-child,td:first-child{text-align:left}
.wide{overflow-x:auto}h1,h2,p{overflow-wrap:anywhere}
#methods+.wide :is(td,th){text-align:left;white-space:normal}
.verdict{font-size:15px}
.note{font-size:12.5px;color:#555;margin:.3em 0;max-width:900px}
img{max-width:100%;border:1px solid #eee;margin:.4em 0}h1{font-size:24px}
h2{font-size:18px;margin-top:1.8em}"""


def write(
    folder: os.PathLike[str] | str,
    above: Sequence[str] = (),
    tables: Sequence[Made] = TABLES,
) -> str:
    """Write folder/report/ and return the path of its index.html.

    Args:
        folder: Folder of an evaluation.
        above: Lines at the top of the page; empty for summary().
        tables: Functions that make the tables. Lines that compare methods by another cost than the
            tables of the paper stand without these tables.

    Raises:
        ApplrError: There are no trials, or the folder cannot be read or written.
    """
    results = Results(folder)
    out = make_folder(results.folder / FOLDER)
    title = f"APPLR: evaluation of {', '.join(results.methods)}"
    made = [make(results) for make in tables]
    filled = [table for table in made if not table.rows.empty]
    for table in filled:
        write_bytes(
            out / f"{table.name}.csv", table.rows.to_csv(index=False, lineterminator="\n").encode()
        )
    missing = absent("matplotlib")
    if missing:
        print(f"the report has no figures: {missing}")
    body = [f"<h1>{html.escape(title)}</h1>"]
    body += [f"<pre class=verdict>{html.escape(line)}</pre>" for line in above or summary(results)]
    if drives_page.write(results, out, title):
        words = "The drives of all methods side by side, as an animation"
        body.append(f'<p><a href="{drives_page.FILE}">{words}</a></p>')
    body += [table.html() for table in filled]
    for file, caption in [] if missing else figures.write(results, out):
        words = html.escape(caption)
        body.append(f'<h2>{words}</h2><img src="{html.escape(file)}" alt="{words}">')
    body += [
        "<h2>How it was measured</h2>",
        *(f"<p>{html.escape(fact)}</p>" for fact in _facts(results)),
    ]
    view = '<meta name=viewport content="width=device-width,initial-scale=1">'
    head = f"<meta charset=utf-8>{view}<title>{html.escape(title)}</title><style>{STYLE}</style>"
    page = ["<!doctype html><html lang=en><head>", head, "</head><body>", *body, "</body></html>\n"]
    write_bytes(out / "index.html", "\n".join(page).encode())
    return str(out / "index.html")


def _facts(results: Results) -> List[str]:
    """Return sentences that describe how the trials were driven."""
    s = results.settings
    per = results.trials.groupby(["method", "world"]).size()
    trials = " to ".join(map(str, dict.fromkeys((per.min(), per.max()))))
    more = (
        ", with the collision monitor" * s["monitor"]
        + ", with predicted moving obstacles" * s["movers"]
    )
    facts = [
        f"{len(results.trials)} trials: {len(results.worlds)} worlds × {len(results.methods)} "
        f"methods × {trials} trials. Protocol: {s['protocol']}. "
        f"Simulator: {s['simulator']}, ground {s['ground']}. "
        f"Planner: {s['planner']}{more}.",
    ]
    if "wall_s" in s:
        wall = tqdm.format_interval(s["wall_s"])
        facts.append(f"Wall time {wall}; base seed {s['seed']}, the same seeds for all methods.")
    for session in s.get("provenance", []):
        versions = ", ".join(" ".join(item) for item in session["versions"].items())
        facts.append(
            "Driven on {date} with commit {commit} on {cpu} ({cores} cores); ".format(**session)
            + f"{versions}. Command: {session['command']}"
        )
    return facts


def summary(results: Results) -> List[str]:
    """Return a line per rival: its comparison over the test worlds, or over all if too few."""
    test = results.by_difficulty(results.of_set("Test"))
    worlds = test if len(test) > 1 else results.worlds
    trials = results.trials[results.trials.world.isin(worlds)]
    lines = []
    for method in results.rivals:
        comparison = results.compare(method, results.baseline, worlds)
        if comparison.worlds:
            lines.append(compared(trials, method, results.baseline, comparison))
    return lines
