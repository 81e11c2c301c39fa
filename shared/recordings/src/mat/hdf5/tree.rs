//! The nodes of a B-tree of version 1, by which names and chunks are found.

use std::io::{Read, Seek};

use super::Reader;
use super::bytes::Bytes;
use crate::mat::problem::MatError;

pub(super) struct Node {
    /// Nodes below it on the way to what the tree holds.
    pub(super) level: u8,
    pub(super) children: Vec<Child>,
}

pub(super) struct Child {
    /// The key before it.
    pub(super) key: Vec<u8>,
    pub(super) address: u64,
}

impl Node {
    /// Reads a node of a tree of this kind, with keys of `key_bytes`. It must be of `level` if that is known: so no tree is endlessly
    /// deep.
    pub(super) fn read<R: Read + Seek>(
        reader: &mut Reader<'_, R>,
        address: u64,
        kind: u8,
        level: Option<u8>,
        key_bytes: usize,
    ) -> Result<Node, MatError> {
        let head = reader.read(address, 24)?;
        let mut bytes = Bytes::new(&head);
        bytes.expect(b"TREE")?;
        let (own_kind, own_level, count) = (bytes.u8()?, bytes.u8()?, bytes.u16()?);
        if own_kind != kind || level.is_some_and(|level| level != own_level) {
            return Err(MatError::Damaged("a part of a tree is none of it"));
        }
        let entries = reader.read(address.saturating_add(24), u64::from(count) * (key_bytes as u64 + 8))?;
        let mut bytes = Bytes::new(&entries);
        let mut children = Vec::new();
        while !bytes.is_empty() {
            children.push(Child { key: bytes.take(key_bytes)?.to_vec(), address: bytes.u64()? });
        }
        Ok(Node { level: own_level, children })
    }
}
