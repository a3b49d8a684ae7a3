"""Units that a file states: what a camera reads is in pixels, of which nothing else is made."""

import pytest

from calibench.core.tables.cells import between, factor_to_base


@pytest.mark.parametrize("spelt", ["px", "pixel", "pixels"])
def test_a_column_may_be_in_pixels_and_in_nothing_else_then(spelt: str) -> None:
    assert factor_to_base("u", spelt) == ("px", 1.0)
    assert between("u", "px", spelt) == 1.0
    with pytest.raises(ValueError, match="column u: unit 'mm'"):
        factor_to_base("u", "mm", "px")
