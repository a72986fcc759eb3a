"""Replay of a node's black box with the same inputs in the same order, and comparison with the recorded outputs.

A file read returns the content in the black box instead of that on the disk; a file write is compared with the black
box.
"""

import os
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord, ProgressWrapper
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import utc_text
from ship_estimation.parameters.schema import ParameterError
from ship_node.adapters.adapter import Adapter, Overload
from ship_node.black_box.black_box_format import (
    EVENTS_TOPIC,
    ChangeRefused,
    ClockJumpedBack,
    ClockStepped,
    Closed,
    DuplicatePublishersChanged,
    EntriesLost,
    Event,
    FileUsed,
    ParametersChanged,
    ServiceCalled,
    Tick,
    event_from_text,
)
from ship_node.messages.inputs_outputs import Batch, OutputMessage
from ship_node.saved_files.saved_document import FileUse
from ship_replay.offline.adapter_chain import suite_text
from ship_replay.verification.black_box_identity import (
    black_box_adapter,
    black_box_config,
    check_definitions,
    check_topics,
    older_message_converters,
)
from ship_replay.verification.verification import (
    UNCOMPARED_TYPES,
    Difference,
    Verification,
    are_texts,
    message_difference,
    stamp_of,
)


class FileUseMismatch(Exception):
    """The replay used a file differently from the node."""

    def __init__(self, difference: Difference) -> None:
        super().__init__(difference.line)
        self.difference = difference


class RecordedFiles:
    """Files of a node as recorded in its black box.

    A read returns the recorded content. A write is compared with the recorded write; nothing is written to the disk.

    Args:
        add_difference: function that is called with each difference in the texts of a written document.
    """

    def __init__(self, add_difference: Callable[[Difference], None]) -> None:
        self._add_difference = add_difference
        self._uses: deque[FileUse] = deque()
        self.time_ns = 0

    def expect(self, use: FileUse) -> None:
        """Add the next recorded use of a file."""
        self._uses.append(use)

    def read(self, path: Path) -> bytes:
        """Return the content that the node read at this time.

        Raises:
            OSError: as recorded for the node.
            FileUseMismatch: the node read nothing, or another file.
        """
        return self._next_use(path, written=False).content or b""

    def write(self, path: Path, content: bytes) -> None:
        """Compare with the content that the node wrote at this time.

        Raises:
            OSError: as recorded for the node.
            FileUseMismatch: the node wrote nothing, another file or other numbers.
        """
        recorded = self._next_use(path, written=True).content or b""
        if recorded != content:
            difference = _content_difference(path, self.time_ns, recorded, content)
            if not difference.is_text:
                raise FileUseMismatch(difference)
            self._add_difference(difference)

    def set_aside(self, path: Path) -> Path:
        """Return the path to which the node renamed a file at this time.

        Raises:
            OSError: as recorded for the node.
            FileUseMismatch: the node renamed nothing, or another file.
        """
        return Path((self._next_use(path, written=True).content or b"").decode())

    def _next_use(self, path: Path, written: bool) -> FileUse:
        use = self._uses.popleft() if self._uses else None
        if use is None or (use.path, use.written) != (str(path), written):
            raise FileUseMismatch(
                Difference(f"file {path}", self.time_ns, "", _use_text(use), f"{'written' if written else 'read'}")
            )
        if use.error is not None:
            raise OSError(use.error, os.strerror(use.error), str(path))
        return use


def replay_black_box(
    bag: Bag,
    adapters: tuple[type[Adapter], ...],
    config_path: Path | None = None,
    out_path: Path | None = None,
    progress: ProgressWrapper = lambda records, bag: records,
) -> Verification:
    """Replay a black box up to its end or to the first missing entry.

    Args:
        bag: the black box.
        adapters: adapters of the nodes known here.
        config_path: configuration to use instead of the black box's own.
        out_path: bag for the outputs; without it the replay ends at the first difference in a number or name.
        progress: function that wraps the iteration over the black box in a progress bar.

    Raises:
        BadInput: the black box cannot be replayed; the text states why.
    """
    adapter_class = black_box_adapter(bag, adapters)
    check_definitions(bag)
    result = Verification()
    config = black_box_config(bag, adapter_class, config_path, result.notes)
    files = RecordedFiles(result.add_difference)

    def make_adapter() -> Adapter:
        adapter = adapter_class(config, RosbagsFactory(), files)
        check_topics(bag, adapter, result.notes, other_config=config_path is not None)
        return adapter

    if out_path is None:
        _BlackBoxReplay(bag, make_adapter, files, result, None).run(progress)
    else:
        with BagWriter(out_path) as writer:
            writer.add_attachment(SUITE_ATTACHMENT, suite_text(bag, config_path))
            _BlackBoxReplay(bag, make_adapter, files, result, writer).run(progress)
    result.notes += bag.problems
    return result


class _BlackBoxReplay:
    """Replay of a black box, entry by entry, with comparison of the outputs."""

    def __init__(
        self,
        bag: Bag,
        make_adapter: Callable[[], Adapter],
        files: RecordedFiles,
        result: Verification,
        writer: BagWriter | None,
    ) -> None:
        self._bag = bag
        self._make_adapter = make_adapter
        self._adapter: Adapter | None = None
        self._files = files
        self._result = result
        self._writer = writer
        self._older_messages = older_message_converters(bag)
        self._inputs: set[str] = set()
        self._outputs: set[str] = set()
        self._pending_outputs: deque[OutputMessage] = deque()
        self._closed = False

    def run(self, progress: ProgressWrapper) -> None:
        """Process the entries up to the end or a missing entry; without an output bag, up to the first difference.

        Differences in texts do not count.
        """
        for number, record in enumerate(progress(self._bag.records_in_file_order(), self._bag), 1):
            if record.sequence != number:
                self._result.incomplete_reason = f"entries are missing before {utc_text(record.log_time_ns)}"
                return
            try:
                self._process_entry(record)
            except FileUseMismatch as problem:
                self._result.add_difference(problem.difference)
            if self._result.incomplete_reason or (self._result.difference is not None and self._writer is None):
                return
        if not self._closed:
            self._result.is_truncated = True
            self._result.incomplete_reason = f"the black box ends without a footer, at {utc_text(self._files.time_ns)}"

    def _process_entry(self, record: BagRecord) -> None:
        time_ns = self._files.time_ns = record.log_time_ns
        if record.topic == EVENTS_TOPIC:
            self._process_event(event_from_text(record.decode().data), time_ns, record.publish_time_ns)
            return
        adapter = self._get_adapter()
        if record.topic in self._inputs:
            batch = Batch.of_message(record.topic, record.decode(), time_ns, record.publish_time_ns)
            self._use(record.topic, time_ns, lambda: adapter.process(batch).output_messages())
        elif record.topic in self._outputs:
            self._compare(record)

    def _process_event(self, event: Event, time_ns: int, waiting_ns: int) -> None:
        if isinstance(event, FileUsed):
            # Files used by the constructor are recorded before the adapter exists.
            self._files.expect(FileUse(event.path, event.written, self._attached_content(event), event.error))
            return
        adapter = self._get_adapter()
        if isinstance(event, Tick):
            self._use("tick", time_ns, lambda: adapter.tick(time_ns, waiting_ns))
        elif isinstance(event, ClockJumpedBack):
            self._use("clock jump back", time_ns, lambda: adapter.clock_jumped_back(time_ns))
        elif isinstance(event, ClockStepped):
            step_ns = event.step_ns
            self._use("clock step", time_ns, lambda: adapter.clock_stepped(step_ns, time_ns, waiting_ns))
        elif isinstance(event, Overload):
            self._use("overload", time_ns, lambda: adapter.overload(event, time_ns, waiting_ns))
        elif isinstance(event, DuplicatePublishersChanged):
            self._call("publishers", time_ns, lambda: adapter.set_duplicate_publishers(event.topic, event.text))
        elif isinstance(event, ServiceCalled):
            answer = self._call(f"~/{event.name}", time_ns, lambda: adapter.service(event.name, time_ns))
            success, message = answer or (None, None)
            self._compare_values(f"~/{event.name}", time_ns, "success", event.success, success)
            self._compare_values(f"~/{event.name}", time_ns, "message", event.message, message)
        elif isinstance(event, ParametersChanged):
            refused = self._call("parameters", time_ns, lambda: _parameter_error(adapter, event))
            self._compare_values("parameters", time_ns, "refused", event.refused, refused)
        elif isinstance(event, ChangeRefused):
            self._result.input_counts["parameters refused"] += 1
        elif isinstance(event, EntriesLost):
            self._result.incomplete_reason = (
                f"the disk was too slow or full for {event.count} entries at {utc_text(time_ns)}"
            )
        elif isinstance(event, Closed):
            self._check_no_pending_outputs(time_ns)
            self._closed = True

    def _use(self, what: str, time_ns: int, call: Callable[[], list[OutputMessage]]) -> None:
        """Call the adapter; its outputs are compared with the following entries of the black box."""
        published = self._call(what, time_ns, call) or []
        for topic, message in published:
            if topic in self._older_messages:
                message = self._older_messages[topic](message)
            if self._writer is not None:
                self._writer.write(topic, message, time_ns)
            if topic in self._outputs:
                self._pending_outputs.append((topic, message))

    def _call(self, what: str, time_ns: int, call: Callable[[], Any]) -> Any:
        """Return the result of a call; if the call raises, return None and add a note, as a live node continues."""
        self._check_no_pending_outputs(time_ns)
        self._result.input_counts[what] += 1
        try:
            return call()
        except FileUseMismatch:
            raise
        except Exception as error:
            self._result.notes.append(f"{what} at {utc_text(time_ns)} raised {type(error).__name__}: {error}")
            return None

    def _get_adapter(self) -> Adapter:
        """Return the adapter, created at its first use: by then the files read at start are known."""
        if self._adapter is None:
            self._adapter = self._make_adapter()
            self._inputs = {topic.topic for topic in self._adapter.inputs}
            # A black box contains all topics of its node: other topics were introduced in a later release.
            self._outputs = {
                topic.topic
                for topic in self._adapter.outputs
                if topic.type_name not in UNCOMPARED_TYPES and topic.topic in self._bag.topics
            }
        return self._adapter

    def _attached_content(self, event: FileUsed) -> bytes | None:
        if event.attachment is None:
            return None
        if event.attachment not in self._bag.attachments:
            text = f"attachment {event.attachment} is missing: the content of {event.path}"
            raise BadInput(text, file=self._bag.path)
        return self._bag.attachments[event.attachment]

    # -- comparison -----------------------------------------------------------------------------------------

    def _compare(self, record: BagRecord) -> None:
        recorded, time_ns = record.decode(), record.log_time_ns
        topic, replayed = self._pending_outputs.popleft() if self._pending_outputs else ("", None)
        if topic != record.topic:
            replayed_text = f"a message on {topic}" if topic else "nothing"
            self._result.add_difference(
                Difference(record.topic, stamp_of(recorded, time_ns), "", "a message", replayed_text)
            )
        else:
            self._result.add(topic, message_difference(topic, recorded, replayed, time_ns))

    def _compare_values(self, what: str, time_ns: int, field: str, recorded: Any, replayed: Any) -> None:
        if recorded != replayed:
            is_text = are_texts(recorded, replayed)
            difference = Difference(what, time_ns, field, repr(recorded), repr(replayed), is_text=is_text)
            self._result.add_difference(difference)

    def _check_no_pending_outputs(self, time_ns: int) -> None:
        """Check that the black box contains all outputs of the last call."""
        if self._pending_outputs:
            topic, message = self._pending_outputs.popleft()
            self._result.add_difference(Difference(topic, stamp_of(message, time_ns), "", "nothing", "a message"))
            self._pending_outputs.clear()


def _parameter_error(adapter: Adapter, event: ParametersChanged) -> str | None:
    """Change live parameters; return the adapter's error about them, or None if it accepts them."""
    try:
        adapter.set_parameters(event.changes)
    except ParameterError as error:
        return str(error)
    return None


def _use_text(use: FileUse | None) -> str:
    return "no use of a file" if use is None else f"{use.path} {'written' if use.written else 'read'}"


def _content_difference(path: Path, time_ns: int, recorded: bytes, replayed: bytes) -> Difference:
    """Return the first differing line, or the lengths, marked as text if the documents differ in texts only."""
    is_text = _differ_in_texts_alone(recorded, replayed)
    one, other = (content.decode(errors="replace").splitlines() for content in (recorded, replayed))
    for number, (a, b) in enumerate(zip(one, other, strict=False), 1):
        if a != b:
            return Difference(f"file {path}", time_ns, f"line {number}", repr(a), repr(b), is_text)
    sizes = f"{len(recorded)} bytes", f"{len(replayed)} bytes"
    return Difference(f"file {path}", time_ns, "length", *sizes, is_text)


def _differ_in_texts_alone(recorded: bytes, replayed: bytes) -> bool:
    """True if two YAML documents are equal except for the words of their texts; False if a document is invalid."""

    def are_equal(one: Any, other: Any) -> bool:
        if isinstance(one, dict) and isinstance(other, dict):
            return list(one) == list(other) and all(map(are_equal, one.values(), other.values()))
        if isinstance(one, list) and isinstance(other, list):
            return len(one) == len(other) and all(map(are_equal, one, other))
        return are_texts(one, other) or repr(one) == repr(other)

    try:
        return are_equal(yaml.safe_load(recorded), yaml.safe_load(replayed))
    except yaml.YAMLError:
        return False
