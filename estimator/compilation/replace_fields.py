"""A named tuple's ``_replace`` in compiled code; numba itself does not know it.

It is made with numba's low-level extension API:
https://numba.readthedocs.io/en/stable/extending/low-level.html
"""

from inspect import Parameter, Signature
from typing import Any

from numba import extending
from numba.core import imputils, types
from numba.core.errors import TypingError
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing import templates

_types: Any = types  # numba ships few types
_templates: Any = templates
_lower: Any = extending.lower_builtin
_borrowed: Any = imputils.impl_ret_borrowed
_POSITIONAL = Parameter.POSITIONAL_OR_KEYWORD


class _Replace(_templates.AbstractTemplate):  # type: ignore[misc]
    """The types of ``tuple._replace(field=value, ...)``: a value has to fit its field's type."""

    key = "namedtuple._replace"

    def generic(self, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        fields = dict(zip(self.this.fields, self.this, strict=True))
        if args:
            raise TypingError("_replace takes its values by name")
        for name, kind in kws.items():
            fits = self.context.can_convert(kind, fields.get(name, _types.undefined))
            if fits is None or fits >= Conversion.unsafe:
                raise TypingError(f"{kind} is no value for the field {name!r} of {self.this}")
        # Lowering sees no names, so they come along as the default of one more parameter.
        names = _types.Omitted(tuple(kws))
        parameters = [Parameter(name, _POSITIONAL) for name in kws]
        parameters.append(Parameter("_names", _POSITIONAL, default=names.value))
        made = _templates.signature(
            self.this, *(fields[name] for name in kws), names, recvr=self.this
        )
        return made.replace(pysig=Signature(parameters))


@_templates.infer_getattr
class _NamedTupleMethods(_templates.AttributeTemplate):  # type: ignore[misc]
    key = _types.BaseNamedTuple

    def resolve__replace(self, kind: Any) -> Any:
        return _types.BoundFunction(_Replace, kind)


@_lower(_Replace.key, _types.NamedTuple, _types.VarArg(_types.Any))
@_lower(_Replace.key, _types.NamedUniTuple, _types.VarArg(_types.Any))
def _lower_replace(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, *_, names = sig.args
    made, *values, _ = args
    for name, value in zip(names.value, values, strict=True):
        made = builder.insert_value(made, value, kind.fields.index(name))
    return _borrowed(context, builder, kind, made)
