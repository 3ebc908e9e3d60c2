"""``fuzzbee profile show|check``: look at a profile, or show what is wrong with one."""

import json
from pathlib import Path
from typing import Annotated

import typer

from estimator.errors import InputError
from fuzzbee.options import examples, option

Name = Annotated[
    str, typer.Argument(metavar="NAME|FILE", help="paper, imu, adaptive or a TOML file.")
]
Plot = Annotated[
    Path | None,
    option("Draw the memberships, the rules and K (extra: plot).", metavar="FILE"),
]
AsJson = Annotated[bool, option("One JSON object.", "--json")]

profile_app = typer.Typer(help="Show or check a profile.", no_args_is_help=True)

EPILOG = examples(
    "fuzzbee profile show imu",
    "fuzzbee profile show paper --plot rules.png",
    "fuzzbee profile check tuned.toml",
)


@profile_app.command(epilog=EPILOG)
def show(profile: Name, as_json: AsJson = False, plot: Plot = None) -> None:
    """Print a profile with every value that was left to its default."""
    import tomli_w

    from estimator.filter.types import gain_in_words
    from estimator.live.settings import settings_of
    from estimator.profile import load_profile, profile_to_json

    chosen = load_profile(profile)
    if plot is not None:
        from fuzzbee.controller import draw_controller

        draw_controller(plot, profile, chosen.k)
    tree = profile_to_json(chosen)
    if as_json:
        print(json.dumps(tree))
    else:
        settings = settings_of(chosen)
        words = gain_in_words(settings.filter, conditioned=settings.conditioned)
        print(f"# {words}\n{tomli_w.dumps(tree)}", end="")


@profile_app.command(epilog=EPILOG)
def check(profile: Name, as_json: AsJson = False) -> None:
    """Check whether a profile can be used.

    If it cannot, report what is wrong and where, and end with status 2.
    """
    from estimator.profile import load_profile

    try:
        checked = load_profile(profile)
    except InputError as error:
        if as_json:
            print(json.dumps({"file": profile, "valid": False, "error": str(error)}))
        raise
    text = "conditioned vectors" if checked.conditioned else "raw vectors"
    if as_json:
        print(json.dumps({"file": profile, "valid": True, "conditioned": checked.conditioned}))
    else:
        print(f"{profile}: valid ({text})")
