"""Reads an MCAP file: every intact record, and one remark for everything that is missing or damaged.

The reader uses neither index nor footer, so that unfinished and damaged files are read as far as they are intact.
Source: MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from numba import njit
from numpy.typing import NDArray

from via_core.errors import BagError, one_line
from via_core.limits import LIMITS, require_regular

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]

MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = 9  # opcode u8, length u64
_MESSAGE_HEAD = 22  # channel u16, sequence u32, log_time u64, publish_time u64
# length of the payload [bytes], times [ns], and rank among all messages of the file
ROW = np.dtype([(name, np.int64) for name in ("length", "log_time", "publish_time", "sequence", "position")])
_BATCH = 64 << 20  # [bytes] of uncompressed chunks processed at once
_INVALID = (struct.error, UnicodeDecodeError, EndOfFile)  # of a record that is too short, or no text
_NOT_UNPACKED = (*_INVALID, zstandard.ZstdError, RuntimeError, OverflowError, MemoryError)  # of a chunk


@dataclass(frozen=True)
class Schema:
    name: str
    encoding: str
    text: bytes


@dataclass(frozen=True)
class Channel:
    topic: str
    schema: Schema | None
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class Messages:
    """Messages of one channel in file order: all payloads, concatenated, and a row of numbers (n,) for each."""

    data: Bytes
    rows: NDArray[np.void]  # (n,) of ROW

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> Integers:
        """A column (n,) of ROW."""
        return np.ascontiguousarray(self.rows[name])


@dataclass(frozen=True)
class Container:
    """Contents of one MCAP file.

    complete  the file ends as the format requires and nothing was skipped
    remarks   one sentence for everything that is missing or was skipped
    unpacked  [bytes] of the uncompressed chunks, with those of the files before it in the bag
    """

    path: Path
    profile: str
    channels: Mapping[int, Channel]
    messages: Mapping[int, Messages]
    metadata: Mapping[str, Mapping[str, str]]
    complete: bool
    remarks: tuple[str, ...]
    unpacked: int = 0


def read_container(path: Path, wanted: Callable[[str], bool] = lambda topic: True, unpacked: int = 0) -> Container:
    """All intact messages of the topics `wanted`. Raises BagError when `path` is not a readable MCAP file.

    unpacked  [bytes] of the uncompressed chunks of the files before it in the bag
    """
    try:
        require_regular(path)
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
            if not head:
                raise BagError(f"{path.name} is empty")
            if head != MAGIC:
                raise BagError(f"{path.name} is not an MCAP file (it begins with {head!r})")
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # unmapped with its last view
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from None
    return _Walk(path, np.frombuffer(mapped, dtype=np.uint8), wanted, unpacked).container()


@njit(cache=True)
def _records(data: Bytes, begin: int, end: int) -> tuple[Bytes, Integers, Integers, int]:
    """Opcode, content offset and content length of every intact record in data[begin:end], and the end of the last."""
    count = 0
    for filling in range(2):
        if filling == 0:
            opcodes, offsets, lengths = np.empty(0, np.uint8), np.empty(0, np.int64), np.empty(0, np.int64)
        else:
            opcodes, offsets, lengths = np.empty(count, np.uint8), np.empty(count, np.int64), np.empty(count, np.int64)
        k, at = 0, begin
        while at + 9 <= end and data[at] != 0:
            length = 0
            for i in range(7):  # a length of 2^56 or more is invalid
                length |= int(data[at + 1 + i]) << (8 * i)
            if data[at + 8] != 0 or length > end - at - 9:
                break
            if filling == 1:
                opcodes[k], offsets[k], lengths[k] = data[at], at + 9, length
            k += 1
            at += 9 + length
        count = k
    return opcodes, offsets, lengths, at


@njit(cache=True)
def _gather(data: Bytes, start: Integers, length: Integers) -> Bytes:
    """The pieces data[start:start+length], concatenated."""
    out = np.empty(length.sum(), np.uint8)
    at = 0
    for k in range(len(start)):
        n = length[k]
        out[at : at + n] = data[start[k] : start[k] + n]
        at += n
    return out


@dataclass
class _Walk:
    path: Path
    data: Bytes
    wanted: Callable[[str], bool]
    unpacked: int  # [bytes] of the bag so far
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    pieces: dict[int, list[Messages]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    count: int = 0

    def container(self) -> Container:
        opcodes, offsets, lengths, end = _records(self.data, len(MAGIC), len(self.data))
        if len(opcodes) == 0 or opcodes[0] != Opcode.HEADER:
            raise BagError(f"{self.path.name} ends before its first record; nothing can be read from it")
        try:
            profile = _Record(self._content(offsets[0], lengths[0])).read_prefixed_string()
        except _INVALID:
            raise BagError(f"{self.path.name} has an invalid header") from None
        loose = opcodes == Opcode.MESSAGE
        if loose.any():
            self._declarations(self.data, opcodes, offsets, lengths)
            self._messages(self.data, offsets[loose], lengths[loose])
        batch: list[bytes] = []
        size = 0
        for offset, length in zip(offsets[opcodes == Opcode.CHUNK].tolist(), lengths[opcodes == Opcode.CHUNK].tolist()):
            whole = self._whole_chunk(offset, length)
            if whole is not None:
                batch.append(whole)
                size += len(whole)
            if size > _BATCH:
                self._batch(batch)
                batch, size = [], 0
        footer = bool((opcodes == Opcode.FOOTER).any())
        if not footer:
            batch.append(self._partial_chunk(end))
        self._batch(batch)
        self._declarations(self.data, opcodes, offsets, lengths)  # the summary repeats those of the chunks
        self._ending(footer, end)
        for offset in offsets[(opcodes == Opcode.STATISTICS) & (lengths >= 8)].tolist():
            promised = int.from_bytes(self._content(offset, 8), "little")
            if promised != self.count:
                self.remarks.append(f"the file holds {self.count} messages, its statistics state {promised}")
        unknown = sorted(self.pieces.keys() - self.channels.keys())
        if unknown:
            lost = sum(len(piece) for channel in unknown for piece in self.pieces[channel])
            self.remarks.append(f"{lost} messages belong to undeclared channels")
        messages = {channel: joined(self.pieces.get(channel, [])) for channel in self.channels}
        remarks = tuple(self.remarks)
        return Container(
            self.path, profile, self.channels, messages, self.metadata, not remarks, remarks, self.unpacked
        )

    def _content(self, offset: int, length: int) -> bytes:
        return self.data[offset : offset + length].tobytes()

    def _declarations(self, data: Bytes, opcodes: Bytes, offsets: Integers, lengths: Integers) -> None:
        """Store the schemas, channels and metadata among these records."""
        for k in np.flatnonzero(np.isin(opcodes, [Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA])):
            try:
                self._declaration(int(opcodes[k]), _Record(data[offsets[k] : offsets[k] + lengths[k]].tobytes()))
            except _INVALID:
                self.remarks.append(f"the record at byte {offsets[k]} is an invalid declaration")

    def _declaration(self, opcode: int, record: ReadDataStream) -> None:
        if opcode == Opcode.METADATA:
            metadata = records.Metadata.read(record)
            self.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.SCHEMA:
            schema = records.Schema.read(record)
            self._declare(
                "schema", schema.id, self.schemas, Schema(schema.name, schema.encoding, schema.data), LIMITS.schemas
            )
        else:
            given = records.Channel.read(record)
            channel = Channel(given.topic, self.schemas.get(given.schema_id), given.message_encoding, given.metadata)
            self._declare("channel", given.id, self.channels, channel, LIMITS.channels)

    def _declare(self, kind: str, number: int, known: dict[int, Any], declared: Any, most: int) -> None:
        """Keep a declaration; the first one of a number counts."""
        if known.setdefault(number, declared) != declared:
            self.remarks.append(f"{kind} {number} is declared twice, and differently")
        if len(known) > most:
            raise BagError(f"{self.path.name} has more than {most} {kind}s")

    def _whole_chunk(self, offset: int, length: int) -> bytes | None:
        """The records of one chunk; None, with a remark, when it is damaged."""
        try:
            chunk = records.Chunk.read(_Record(self._content(offset, length)))
            size, checksum = chunk.uncompressed_size, chunk.uncompressed_crc
            if size > LIMITS.chunk:
                raise BagError(f"it states {size} bytes, more than {LIMITS.chunk}")
            content = self._unpacked(chunk, size)
        except BagError as error:
            reason = str(error)
        except _NOT_UNPACKED as error:
            reason = one_line(error)
        else:
            if len(content) != size:
                reason = f"it holds {len(content)} bytes, its header states {size}"
            elif checksum and zlib.crc32(content) != checksum:
                reason = "its checksum differs"
            else:
                self._pay(size)
                return content
        self.remarks.append(f"the chunk at byte {offset - _RECORD_HEAD} is left out: {reason}")
        return None

    def _unpacked(self, chunk: records.Chunk, size: int) -> bytes:
        """The content of a chunk, at most one byte more than `size`; of a truncated one its beginning."""
        if chunk.compression == "":
            return chunk.data[: size + 1]
        if chunk.compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                return bytes(reader.read(size + 1))
        if chunk.compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1))
        raise BagError(f"compression '{chunk.compression}' is unknown")

    def _pay(self, size: int) -> None:
        """Raise BagError when the bag becomes larger than the limit."""
        self.unpacked += size
        if self.unpacked > LIMITS.bag:
            raise BagError(f"with {self.path.name} the bag exceeds {LIMITS.bag} bytes, half of this machine's memory")

    def _partial_chunk(self, begin: int) -> bytes:
        """The readable part of the chunk record at `begin` that the end of the file truncates; may be empty."""
        rest = self.data[begin:].tobytes()
        if len(rest) <= _RECORD_HEAD or rest[0] != Opcode.CHUNK:
            return b""
        try:
            chunk = records.Chunk.read(ReadDataStream(BytesIO(rest[_RECORD_HEAD:])))  # its data may be truncated
            return self._unpacked(chunk, min(chunk.uncompressed_size, LIMITS.chunk))
        except (*_NOT_UNPACKED, BagError):
            return b""

    def _batch(self, chunks: list[bytes]) -> None:
        data = np.frombuffer(b"".join(chunks), dtype=np.uint8)
        begin = 0
        parts = []
        for chunk in chunks:  # one by one: a damaged end of a chunk does not hide the next chunk
            parts.append(_records(data, begin, begin + len(chunk))[:3])
            begin += len(chunk)
        if not parts:
            return
        opcodes, offsets, lengths = (np.concatenate(column) for column in zip(*parts))
        self._declarations(data, opcodes, offsets, lengths)
        self._messages(data, offsets[opcodes == Opcode.MESSAGE], lengths[opcodes == Opcode.MESSAGE])

    def _messages(self, data: Bytes, offset: Integers, length: Integers) -> None:
        short = length < _MESSAGE_HEAD
        if short.any():
            self.remarks.append(f"{int(short.sum())} message records are too short")
            offset, length = offset[~short], length[~short]
        position = self.count + np.arange(len(offset), dtype=np.int64)
        self.count += len(offset)
        channels = _read(data, offset, "<u2")
        for number in np.unique(channels):
            channel = self.channels.get(int(number))
            if channel is not None and not self.wanted(channel.topic):
                continue
            mine = channels == number
            at = offset[mine]
            size = length[mine] - _MESSAGE_HEAD
            rows = np.empty(len(at), ROW)
            rows["length"], rows["position"] = size, position[mine]
            rows["log_time"], rows["publish_time"] = _read(data, at + 6, "<i8"), _read(data, at + 14, "<i8")
            rows["sequence"] = _read(data, at + 2, "<u4")
            piece = Messages(_gather(data, at + _MESSAGE_HEAD, size), rows)
            self.pieces.setdefault(int(number), []).append(piece)

    def _ending(self, footer: bool, end: int) -> None:
        size = len(self.data)
        if footer and self.data[-len(MAGIC) :].tobytes() == MAGIC and end == size - len(MAGIC):
            return
        if footer:
            self.remarks.append(f"the file has a footer but no valid end ({size - end} extra bytes)")
        elif end == size:
            self.remarks.append("the file was not finished: it has no footer")
        else:
            self.remarks.append(f"the file was not finished: it ends within the record at byte {end}")


class _Record(ReadDataStream):
    """The content of one record. Raises EndOfFile where it is too short, also by a part of a piece."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EndOfFile(f"{length} bytes wanted, {self._size - self.count} left")
        return super().read(length)


def _read(data: Bytes, offset: Integers, form: str) -> Integers:
    """One number of numpy format `form` at each byte offset of `data`, aligned or not."""
    width = np.dtype(form).itemsize
    if len(offset) == 0:
        return np.empty(0, np.int64)
    everywhere = np.ndarray(len(data) - width + 1, dtype=form, buffer=data, strides=(1,))
    return everywhere[offset].astype(np.int64)


def joined(pieces: list[Messages]) -> Messages:
    """The messages of all pieces in this order."""
    if len(pieces) == 1:
        return pieces[0]
    every = [Messages(np.empty(0, np.uint8), np.empty(0, ROW)), *pieces]
    return Messages(np.concatenate([each.data for each in every]), np.concatenate([each.rows for each in every]))


def files_of(path: Path) -> Iterator[Path]:
    """The MCAP files of a bag directory in order, unfinished ones included, or `path` itself when it is a file."""
    if path.is_dir():
        found = [file for file in path.iterdir() if file.name.endswith((".mcap", ".mcap.active"))]
        yield from sorted(found, key=_split_number)
    else:
        yield path


def _split_number(path: Path) -> tuple[int, str]:
    digits = path.name.split(".mcap")[0].rpartition("_")[2]
    return (int(digits) if digits.isdigit() else -1, path.name)
