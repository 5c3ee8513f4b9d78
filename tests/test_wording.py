"""Lists in sentences: the first three, and how many more."""

import pytest

from bodylog.wording import list_in_words


@pytest.mark.parametrize(
    ("count", "text"), [(1, "1.0 s"), (3, "1.0, 2.0, 3.0 s"), (5, "1.0, 2.0, 3.0 s and 2 times more")]
)
def test_list_names_three_and_counts_the_rest(count, text):
    assert list_in_words([f"{k}.0" for k in range(1, count + 1)], " times", unit=" s") == text


def test_list_of_clauses_ends_with_a_clause():
    assert list_in_words(list("abcd"), " joints", "; ") == "a; b; c; and 1 joints more"
