"""Docstrings as Markdown: doctests become code blocks, Sphinx's roles the code that they name."""

from __future__ import annotations

import re

from griffe import Extension, Object

_DOCTEST = re.compile(r"^( *)>>> .*(?:\n\1(?! *$)\S?.*)*", re.MULTILINE)
_ROLE = re.compile(r":(?:class|func|meth|attr|data|mod|obj):`~?([^`]+)`")


class Docstrings(Extension):
    """Rewrites each docstring before it is parsed."""

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Rewrite.

        Args:
            obj: a module, class, function or attribute.
        """
        if obj.docstring is not None:
            text = _ROLE.sub(r"`\1`", obj.docstring.value)
            obj.docstring.value = _DOCTEST.sub(_fenced, text)


def _fenced(found: re.Match[str]) -> str:
    indent = found[1]
    return f"{indent}```pycon\n{found[0]}\n{indent}```"
