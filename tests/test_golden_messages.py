"""The texts of findings and errors are those of one file, which shows each change of words."""

import re

from messages import GOLDEN, messages, written


def test_texts_are_those_that_were_looked_at() -> None:
    changed = "run python tests/messages.py and look at the change of tests/messages.txt"
    assert written() == GOLDEN.read_text(encoding="utf-8"), changed


def test_codes_are_words_and_texts_name_no_option() -> None:
    for code, text, remedy in messages():
        assert re.fullmatch(r"[a-z]+(-[a-z]+)*", code)
        assert not re.search(r"(^|[ (])--[a-z]|\bdocdepth [a-z]+ [A-Z]", text + " " + remedy), text
