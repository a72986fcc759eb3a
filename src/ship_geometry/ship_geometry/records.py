"""``dataclass`` as of the standard library, for a class that is ready in a tenth of the time.

The standard library writes and compiles six functions for each frozen dataclass; a node has 130 of them, and this
took a quarter of its start. Here comparing, telling, hashing and refusing to change are functions that all classes
share, and only ``__init__`` is written for each: by the first call, so that a class that is never used costs nothing.
Everything else is the standard library's: ``fields``, ``replace``, ``field``, defaults, ``__post_init__``,
inheritance. Known here are ``frozen``, ``kw_only`` and ``eq``. A type checker sees the standard library's decorator.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:
    import dataclasses

    _BY_FACTORY = object()
    """Stands for an argument that was not given and whose field has a ``default_factory``."""

    def dataclass(cls=None, /, *, frozen=False, kw_only=False, eq=True):
        """A class of fields, as by ``dataclasses.dataclass``.

        Example:
            >>> @dataclass(frozen=True)
            ... class Star:
            ...     hip: int
            ...     magnitude: float = 6.0
            >>> Star(11767), Star(11767) == Star(11767, magnitude=2.0)
            (Star(hip=11767, magnitude=6.0), False)
        """
        if cls is None:
            return lambda made: dataclass(made, frozen=frozen, kw_only=kw_only, eq=eq)
        own = set(vars(cls))
        # Without a text the standard library would make one of the signature, which takes longer than all else here.
        cls.__doc__ = cls.__doc__ or cls.__name__
        dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(cls)
        shared = {"__init__": _writing_init(cls, frozen), "__repr__": _repr}
        if eq:
            shared |= {"__eq__": _eq, "__hash__": _hash if frozen else None}
        if frozen:
            shared |= {"__setattr__": _refuse_to_set, "__delattr__": _refuse_to_delete}
        for name, function in shared.items():
            if name not in own or (name == "__hash__" and "__eq__" not in own):
                setattr(cls, name, function)
        return cls

    def _writing_init(cls, frozen):
        """What stands for ``__init__`` until it is called: it writes the true one."""

        def write_and_call(self, *args, **kwargs):
            if vars(cls)["__init__"] is write_and_call:
                cls.__init__ = _init(cls, frozen)
            cls.__init__(self, *args, **kwargs)

        return write_and_call

    def _init(cls, frozen):
        known = {"_BY_FACTORY": _BY_FACTORY, "_set": object.__setattr__}
        positional, by_name, body = ["self"], [], []
        for field in dataclasses.fields(cls):
            name, given = field.name, ""
            value = name if field.init else None
            if field.default is not dataclasses.MISSING:
                known[f"_default_{name}"] = field.default
                given = f"=_default_{name}"
            elif field.default_factory is not dataclasses.MISSING:
                known[f"_make_{name}"] = field.default_factory
                given = "=_BY_FACTORY"
                made = f"_make_{name}()"
                value = f"{made} if {name} is _BY_FACTORY else {name}" if field.init else made
            if field.init:
                (by_name if field.kw_only else positional).append(name + given)
            if value is not None:
                body.append(f"_set(self, {name!r}, {value})" if frozen else f"self.{name} = {value}")
        if hasattr(cls, "__post_init__"):
            body.append("self.__post_init__()")
        arguments = ", ".join([*positional, *(["*", *by_name] if by_name else [])])
        exec(f"def __init__({arguments}):\n " + "\n ".join(body or ["pass"]), known)
        init = known["__init__"]
        init.__qualname__ = f"{cls.__qualname__}.__init__"
        return init

    def _repr(self):
        told = (f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self) if field.repr)
        return f"{type(self).__qualname__}({', '.join(told)})"

    def _values(self):
        return tuple([getattr(self, field.name) for field in dataclasses.fields(self) if field.compare])

    def _eq(self, other):
        return _values(self) == _values(other) if type(self) is type(other) else NotImplemented

    def _hash(self):
        return hash(_values(self))

    def _refuse_to_set(self, name, value):
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")

    def _refuse_to_delete(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
