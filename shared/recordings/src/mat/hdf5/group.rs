//! What a group holds: names, and the addresses of headers.

use std::io::{Read, Seek};

use super::bytes::Bytes;
use super::header::{LINK, LINK_INFO, Message, SYMBOL_TABLE, find};
use super::tree::{Child, Node};
use super::{Reader, UNDEFINED};
use crate::mat::problem::MatError;

/// The names in the group with this header, each with the address of its own header.
pub(super) fn links<R: Read + Seek>(
    reader: &mut Reader<'_, R>,
    messages: &[Message],
) -> Result<Vec<(String, u64)>, MatError> {
    if let Some(mut table) = find(messages, SYMBOL_TABLE) {
        let (tree, heap) = (table.u64()?, table.u64()?);
        let names = heap_data(reader, heap)?;
        let mut links = Vec::new();
        symbols(reader, tree, None, &names, &mut links)?;
        return Ok(links);
    }
    if let Some(mut info) = find(messages, LINK_INFO) {
        info.skip(1)?;
        let has_order = info.u8()? & 1 != 0;
        info.skip(if has_order { 8 } else { 0 })?;
        if info.u64()? != UNDEFINED {
            return Err(MatError::Hdf5("it holds more variables than its header has room for"));
        }
    }
    let links = messages.iter().filter(|message| message.kind == LINK);
    links.filter_map(|message| link(Bytes::new(&message.data)).transpose()).collect()
}

/// A link by its message; `None` if it leads elsewhere than to a header of this file.
fn link(mut bytes: Bytes<'_>) -> Result<Option<(String, u64)>, MatError> {
    bytes.skip(1)?;
    let flags = bytes.u8()?;
    let kind = if flags & 0x08 != 0 { bytes.u8()? } else { 0 };
    let order = if flags & 0x04 != 0 { 8 } else { 0 };
    let characters = if flags & 0x10 != 0 { 1 } else { 0 };
    bytes.skip(order + characters)?;
    let length = bytes.number(1 << (flags & 0x03))?;
    let name = bytes.take(usize::try_from(length).unwrap_or(usize::MAX))?;
    let name = String::from_utf8_lossy(name).into_owned();
    Ok(if kind == 0 { Some((name, bytes.u64()?)) } else { None })
}

/// The text in which the names of a symbol table stand.
fn heap_data<R: Read + Seek>(reader: &mut Reader<'_, R>, address: u64) -> Result<Vec<u8>, MatError> {
    let heap = reader.read(address, 32)?;
    let mut bytes = Bytes::new(&heap);
    bytes.expect(b"HEAP")?;
    bytes.skip(4)?;
    let length = bytes.u64()?;
    bytes.skip(8)?;
    let data = bytes.u64()?;
    reader.read(data, length)
}

/// Appends the symbols below a node of the B-tree, which must be of level `level` if that is known.
fn symbols<R: Read + Seek>(
    reader: &mut Reader<'_, R>,
    address: u64,
    level: Option<u8>,
    names: &[u8],
    links: &mut Vec<(String, u64)>,
) -> Result<(), MatError> {
    const KIND: u8 = 0;
    const KEY: usize = 8;
    let node = Node::read(reader, address, KIND, level, KEY)?;
    for Child { address: child, .. } in node.children {
        if let Some(below) = node.level.checked_sub(1) {
            symbols(reader, child, Some(below), names, links)?;
            continue;
        }
        let head = reader.read(child, 8)?;
        let mut bytes = Bytes::new(&head);
        bytes.expect(b"SNOD")?;
        bytes.skip(2)?;
        let count = bytes.u16()?;
        const ENTRY: u64 = 40;
        let entries = reader.read(child.saturating_add(8), u64::from(count) * ENTRY)?;
        for entry in entries.chunks_exact(ENTRY as usize) {
            let mut bytes = Bytes::new(entry);
            let (name, header) = (bytes.u64()?, bytes.u64()?);
            let name = usize::try_from(name).ok().and_then(|start| names.get(start..));
            let name = name.ok_or(MatError::Damaged("a variable has no name"))?;
            let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
            links.push((String::from_utf8_lossy(name).into_owned(), header));
        }
    }
    Ok(())
}
