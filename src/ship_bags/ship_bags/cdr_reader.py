"""Reader of the messages of a topic by templates (:class:`ship_bags.cdr_template.CdrTemplate`)."""

from ship_bags.cdr_template import CdrMessage, CdrTemplate, Definitions


class CdrReader:
    """Reads the messages of a topic by templates, one for each message length.

    Args:
        type_name: the type.
        definitions: returns the definition of this type, or of a type that it refers to.
    """

    _MAX_TEMPLATES = 16
    """Maximum number of message lengths with a template, so that changing texts do not fill the memory."""

    def __init__(self, type_name: str, definitions: Definitions) -> None:
        self._type_name = type_name
        self._definitions = definitions
        self._is_fixed = _is_fixed(type_name, definitions)
        self._templates: dict[int, CdrTemplate] = {}

    def message(self, data: bytes) -> CdrMessage | None:
        """Return the message; None if no template fits.

        A template does not fit if the encapsulation differs, the message is damaged, or its texts differ from those in
        the first message of the same length. Types with sequences have no template, because their layout changes from
        message to message.
        """
        template = self._templates.get(len(data)) or self._add_template(data)
        return template.message(data) if template is not None and template.matches(data) else None

    def _add_template(self, data: bytes) -> CdrTemplate | None:
        """Return a template for all messages of a length, made from the first such message."""
        if not self._is_fixed or len(self._templates) >= self._MAX_TEMPLATES:
            return None
        try:
            template = CdrTemplate.of_message(self._type_name, self._definitions, data)
        except ValueError:
            return None
        self._templates[len(data)] = template
        return template


def _is_fixed(type_name: str, definitions: Definitions) -> bool:
    """True if messages of a type differ only in numbers and texts, and all their fields have templates."""
    try:
        fields = definitions(type_name).values()
    except TypeError:
        return False
    return not any(
        field.is_sequence or ("/" in field.element and not _is_fixed(field.element, definitions)) for field in fields
    )
