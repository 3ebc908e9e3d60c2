"""What sets the gain K, in a sentence for people."""

from estimator.filter.types import FilterParams


def gain_in_words(params: FilterParams, *, conditioned: bool) -> str:
    """One sentence. ``conditioned`` says whether the filter is given prepared vectors."""
    if params.gain_is_fixed:
        return f"a constant of {params.fixed_gain:g} sets K"
    if not params.gain_knows_noise:
        return "the paper's fuzzy rules set K, which suit the noise they were tuned on"
    if conditioned:
        return "fuzzy rules in measured noise set K, on conditioned vectors"
    return "fuzzy rules in measured noise set K, on raw vectors"
