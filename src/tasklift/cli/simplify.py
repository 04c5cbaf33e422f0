"""``tasklift simplify``: which simpler task to learn first."""

from __future__ import annotations

from pathlib import Path

import click

from tasklift.cli.options import as_json, folder, path, progress, quiet
from tasklift.cli.runs import print_tables
from tasklift.cli.terminal import say, say_json


@click.command("simplify")
@click.argument("spec", type=path)
@folder(help="Folder for the search and the recommended spec; the same command resumes there.")
@click.option("--allow-imports", is_flag=True, help="Let the spec name any installed module. Importing runs code.")
@quiet
@as_json
def simplify_command(spec: Path, out: Path | None, allow_imports: bool, quiet: bool, as_json: bool) -> None:
    """Say which simpler task to learn first, or that none helps.

    SPEC is a spec of `learn` with one stage, the target task, and a table [simplify].
    """
    from tasklift.studies.simplify.answer import simplify
    from tasklift.studies.simplify.search import study_of

    study = study_of(spec, allow_imports=allow_imports)
    if not (quiet or as_json):
        more = f", and at most {study.most_chains} chains of two" if study.most_chains else ""
        say(f"{len(study.found)} simpler tasks{more}; the search spends at most {study.price():,} episodes", err=True)
    with progress() as show:
        answer = simplify(spec, out, allow_imports=allow_imports, progress=show)
    race, judged = answer.tables
    if as_json:
        tables = {
            name: [dict(zip(table.headers, row, strict=True)) for row in table.rows]
            for name, table in (("race", race), ("judged", judged))
        }
        best = None if answer.best is None else answer.best.words
        say_json({"best": best, "says": answer.lines, **tables, "curriculum": dict(answer.document)})
        return
    print_tables(race)
    print_tables(judged)
    say("\n".join(answer.lines))
    if out is not None:
        say(f"recommended spec: {out / 'curriculum.json'}")
