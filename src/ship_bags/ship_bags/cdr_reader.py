"""Reads the messages of a topic by templates, where they differ in numbers alone."""

from ship_bags.cdr_template import CdrMessage, CdrTemplate, Definitions


class CdrReader:
    """Reads the messages of a topic by their layout, as long as they differ in numbers alone.

    Args:
        type_name: the type.
        definitions: gives its definition, and those of all that it refers to.
    """

    _MOST_TEMPLATES = 16
    """So many lengths have a template: texts that always change must not fill the memory."""

    def __init__(self, type_name: str, definitions: Definitions) -> None:
        self._type_name = type_name
        self._definitions = definitions
        self._is_fixed = _is_fixed(type_name, definitions)
        self._templates: dict[int, CdrTemplate] = {}

    def message(self, data: bytes) -> CdrMessage | None:
        """The message; None where a message object must read it: of another encapsulation, other texts, damaged.

        A type with sequences is read by message objects, for its layout changes from message to message.
        """
        template = self._templates.get(len(data)) or self._laid_out(data)
        return template.message(data) if template is not None and template.fits(data) else None

    def _laid_out(self, data: bytes) -> CdrTemplate | None:
        """The template of the first message of a length, for all of this length."""
        if not self._is_fixed or len(self._templates) >= self._MOST_TEMPLATES:
            return None
        try:
            template = CdrTemplate.of_message(self._type_name, self._definitions, data)
        except ValueError:
            return None
        self._templates[len(data)] = template
        return template


def _is_fixed(type_name: str, definitions: Definitions) -> bool:
    """Whether messages of a type differ in their numbers and texts alone, and there are templates for them."""
    try:
        fields = definitions(type_name).values()
    except TypeError:
        return False
    return not any(
        field.is_sequence or ("/" in field.element and not _is_fixed(field.element, definitions)) for field in fields
    )
