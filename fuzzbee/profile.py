"""``fuzzbee profile show|check``: look at a profile, or show what is wrong with one."""

import json
from pathlib import Path

import typer

from estimator.errors import InputError
from fuzzbee import options as opt

NAME = typer.Argument(metavar="NAME|FILE", help="paper, imu, adaptive or a TOML file.")
PLOT = opt.option("Draw the memberships, the rules and K (extra: plot).", "--plot", metavar="FILE")
AS_JSON = opt.option("One JSON object.", "--json", default=False)

profile_app = typer.Typer(help="Show or check a profile.", no_args_is_help=True)

EPILOG = opt.examples(
    "fuzzbee profile show imu",
    "fuzzbee profile show paper --plot rules.png",
    "fuzzbee profile check tuned.toml",
)


@profile_app.command(epilog=EPILOG)
def show(profile: str = NAME, as_json: bool = AS_JSON, plot: Path | None = PLOT) -> None:
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
def check(profile: str = NAME, as_json: bool = AS_JSON) -> None:
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
