//! Whether the entropy-coded data of a JPEG file hold its whole picture.
//!
//! The decoder fills up what is missing with gray and says nothing. Here the Huffman codes are walked through without
//! decoding a coefficient: ITU-T T.81, Annex F (sequential) and Annex G (progressive). Files of other processes
//! (arithmetic, lossless, hierarchical), which the decoder refuses, pass.

/// Scans and tables that are walked through; the decoder refuses more scans.
const MOST_SCANS: usize = 100;
const MOST_TABLES: usize = 4096;

/// What is wrong with the data.
#[derive(Debug, PartialEq)]
pub(crate) enum Fault {
    /// The file ends before the end-of-image marker.
    NoEnd,
    /// The data of a scan end when so many of its units (out of) are there.
    Short(usize, usize),
    /// A code that stands for nothing.
    Corrupt(usize, usize),
    /// A component has no scan.
    NoScan,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let percent = |done: &usize, all: &usize| 100 * done / all.max(&1);
        match self {
            Self::NoEnd => write!(f, "the JPEG ends before its picture does (truncated); copy the file again"),
            Self::Short(done, all) => {
                write!(f, "the JPEG's data end at {} % of its picture (truncated)", percent(done, all))?;
                write!(f, "; copy the file again")
            }
            Self::Corrupt(done, all) => {
                write!(f, "the JPEG's data are damaged at {} % of its picture", percent(done, all))
            }
            Self::NoScan => write!(f, "the JPEG lacks the data of a colour channel (truncated); copy the file again"),
        }
    }
}

/// Walks through all scans of `file`, whose picture the decoder takes to be of `size`.
///
/// # Errors
/// The first fault.
pub(crate) fn check(file: &[u8], size: (usize, usize)) -> Result<(), Fault> {
    let mut walk = Walk { size, ..Walk::default() };
    let mut at = 2;
    loop {
        at = next_marker(file, at).ok_or(Fault::NoEnd)?;
        let marker = file[at + 1];
        if marker == 0xd9 {
            return if walk.is_complete() { Ok(()) } else { Err(Fault::NoScan) };
        }
        let length = file.get(at + 2..at + 4).ok_or(Fault::NoEnd)?;
        let end = at + 2 + usize::from(u16::from_be_bytes([length[0], length[1]])).max(2);
        let segment = file.get(at + 4..end).ok_or(Fault::NoEnd)?;
        at = end;
        let understood = match marker {
            0xc0..=0xc2 => walk.frame(segment, marker == 0xc2),
            0xc4 => walk.tables(segment),
            0xdd => walk.restart(segment),
            0xda => match walk.scan_of(segment) {
                Some(scan) => {
                    at += walk.scan(&scan, &file[at..])?;
                    Some(())
                }
                None => None,
            },
            // Other processes than Huffman coded DCT.
            0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => None,
            _ => Some(()),
        };
        if understood.is_none() {
            // Whatever it is, the decoder says what it cannot do; that the file ends well is known here.
            return if reaches_end(file, at) { Ok(()) } else { Err(Fault::NoEnd) };
        }
    }
}

/// Where the next marker is that is neither a stuffed zero nor a restart; in what precedes, fill bytes are skipped.
fn next_marker(file: &[u8], mut at: usize) -> Option<usize> {
    while at + 1 < file.len() && (file[at] != 0xff || matches!(file[at + 1], 0x00 | 0x01 | 0xff | 0xd0..=0xd7)) {
        at += 1;
    }
    (at + 1 < file.len()).then_some(at)
}

/// Whether the marker structure runs through to the end-of-image marker (thumbnails inside segments do not count).
fn reaches_end(file: &[u8], mut at: usize) -> bool {
    while let Some(marker) = next_marker(file, at) {
        if file[marker + 1] == 0xd9 {
            return true;
        }
        let Some(length) = file.get(marker + 2..marker + 4) else { return false };
        at = marker + 2 + usize::from(u16::from_be_bytes([length[0], length[1]]));
    }
    false
}

#[derive(Default)]
struct Walk {
    size: (usize, usize),
    progressive: bool,
    components: Vec<Component>,
    /// Units of the whole picture across and down, where scans interleave components.
    mcus: (usize, usize),
    restart: usize,
    scans: usize,
    tables_seen: usize,
    dc: [Option<Huffman>; 4],
    ac: [Option<Huffman>; 4],
}

struct Component {
    id: u8,
    h: usize,
    v: usize,
    /// Blocks that hold picture, across and down.
    blocks: (usize, usize),
    /// Blocks in a row of whole units.
    stride: usize,
    /// Progressive: a bit for each coefficient that is not zero so far, per block.
    nonzero: Vec<u64>,
    seen: bool,
}

/// The parameters of one scan.
struct Scan {
    /// Component, and the numbers of its DC and AC tables.
    parts: Vec<(usize, usize, usize)>,
    /// First and last coefficient.
    band: (usize, usize),
    /// Whether it refines bits of an earlier scan.
    refines: bool,
}

impl Walk {
    fn is_complete(&self) -> bool {
        self.components.iter().all(|c| c.seen)
    }

    fn frame(&mut self, s: &[u8], progressive: bool) -> Option<()> {
        let (&[precision, h1, h0, w1, w0, count], rest) = s.split_first_chunk::<6>()?;
        let (width, height) = (usize::from(w1) << 8 | usize::from(w0), usize::from(h1) << 8 | usize::from(h0));
        let parts = rest.get(..3 * usize::from(count))?.as_chunks::<3>().0;
        let sane = |p: &[u8; 3]| (1..=4).contains(&(p[1] >> 4)) && (1..=4).contains(&(p[1] & 15));
        // One frame of the decoder's size (a height of zero comes behind the first scan); 12 bits are not decoded.
        let first = self.components.is_empty() && (width, height) == self.size && width > 0 && height > 0;
        if precision != 8 || !first || !(1..=4).contains(&parts.len()) || !parts.iter().all(sane) {
            return None;
        }
        let sampling: Vec<(usize, usize)> =
            parts.iter().map(|p| (usize::from(p[1] >> 4), usize::from(p[1] & 15))).collect();
        let (h_max, v_max) = (sampling.iter().map(|s| s.0).max()?, sampling.iter().map(|s| s.1).max()?);
        self.mcus = (width.div_ceil(8 * h_max), height.div_ceil(8 * v_max));
        self.progressive = progressive;
        self.components = parts
            .iter()
            .zip(sampling)
            .map(|(p, (h, v))| {
                let blocks = ((width * h).div_ceil(8 * h_max), (height * v).div_ceil(8 * v_max));
                let (stride, rows) = (self.mcus.0 * h, self.mcus.1 * v);
                let nonzero = if progressive { vec![0; stride * rows] } else { Vec::new() };
                Component { id: p[0], h, v, blocks, stride, nonzero, seen: false }
            })
            .collect();
        Some(())
    }

    fn tables(&mut self, mut s: &[u8]) -> Option<()> {
        while let Some((&kind, rest)) = s.split_first() {
            let (lengths, rest) = rest.split_first_chunk::<16>()?;
            let count = lengths.iter().map(|&n| usize::from(n)).sum();
            let (values, rest) = rest.split_at_checked(count)?;
            self.tables_seen += 1;
            let table = Huffman::new(lengths, values).filter(|_| self.tables_seen <= MOST_TABLES)?;
            let tables = if kind >> 4 == 0 { &mut self.dc } else { &mut self.ac };
            *tables.get_mut(usize::from(kind & 15))? = Some(table);
            s = rest;
        }
        Some(())
    }

    fn restart(&mut self, s: &[u8]) -> Option<()> {
        self.restart = usize::from(u16::from_be_bytes(*s.first_chunk::<2>()?));
        Some(())
    }

    fn scan_of(&mut self, s: &[u8]) -> Option<Scan> {
        let (&count, rest) = s.split_first()?;
        let (parts, rest) = rest.split_at_checked(2 * usize::from(count))?;
        let &[first, last, bits, ..] = rest else { return None };
        let parts: Option<Vec<(usize, usize, usize)>> = parts
            .as_chunks::<2>()
            .0
            .iter()
            .map(|p| {
                let component = self.components.iter().position(|c| c.id == p[0])?;
                Some((component, usize::from(p[1] >> 4), usize::from(p[1] & 15)))
            })
            .collect();
        let (parts, first, last) = (parts?, usize::from(first), usize::from(last));
        let band = if self.progressive { (first, last) } else { (0, 63) };
        self.scans += 1;
        let sane = self.scans <= MOST_SCANS
            && !parts.is_empty()
            && band.0 <= band.1
            && band.1 < 64
            && (band.0 == 0 || parts.len() == 1);
        if !sane || self.progressive && band.0 == 0 && band.1 != 0 {
            return None;
        }
        let scan = Scan { parts, band, refines: self.progressive && bits >> 4 != 0 };
        // Tables that are not there: the decoder says so.
        let has = |tables: &[Option<Huffman>; 4], i: usize| tables.get(i).is_some_and(Option::is_some);
        let tables_there = scan.parts.iter().all(|&(_, dc, ac)| {
            (scan.band.0 > 0 || scan.refines || has(&self.dc, dc)) && (scan.band.1 == 0 || has(&self.ac, ac))
        });
        if !tables_there {
            return None;
        }
        scan.parts.iter().filter(|_| scan.band.0 == 0).for_each(|&(c, ..)| self.components[c].seen = true);
        Some(scan)
    }

    /// Walks through one scan; returns its bytes.
    fn scan(&mut self, scan: &Scan, data: &[u8]) -> Result<usize, Fault> {
        let alone = scan.parts.len() == 1;
        let (across, down) = if alone { self.components[scan.parts[0].0].blocks } else { self.mcus };
        let units = across * down;
        let mut bits = Bits::new(data);
        let mut eob_run = 0;
        for unit in 0..units {
            if self.restart > 0 && unit > 0 && unit % self.restart == 0 {
                bits.restart().ok_or(Fault::Short(unit, units))?;
                eob_run = 0;
            }
            let (x, y) = (unit % across, unit / across);
            for &(component, dc, ac) in &scan.parts {
                let c = &mut self.components[component];
                let (h, v) = if alone { (1, 1) } else { (c.h, c.v) };
                for block in 0..h * v {
                    let (bx, by) = (x * h + block % h, y * v + block / h);
                    // The tables were seen to be there when the scan was taken apart.
                    let (dc, ac) = (self.dc.get(dc).and_then(Option::as_ref), self.ac.get(ac).and_then(Option::as_ref));
                    let walked = if !self.progressive {
                        sequential(&mut bits, dc, ac)
                    } else if scan.band.1 == 0 {
                        if scan.refines { bits.skip(1) } else { first_dc(&mut bits, dc) }
                    } else {
                        let nonzero = &mut c.nonzero[by * c.stride + bx];
                        let walk = if scan.refines { refine_ac } else { first_ac };
                        walk(&mut bits, ac, scan.band, nonzero, &mut eob_run)
                    };
                    if walked.is_none() {
                        let fault = if bits.is_over() { Fault::Short } else { Fault::Corrupt };
                        return Err(fault(unit, units));
                    }
                }
            }
        }
        Ok(bits.position())
    }
}

/// One block of a sequential scan.
fn sequential(bits: &mut Bits<'_>, dc: Option<&Huffman>, ac: Option<&Huffman>) -> Option<()> {
    first_dc(bits, dc)?;
    let mut k = 1;
    while k < 64 {
        let symbol = bits.symbol(ac?)?;
        let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
        if size == 0 && run < 15 {
            return Some(());
        }
        bits.skip(size)?;
        k += run + 1;
    }
    (k == 64).then_some(())
}

fn first_dc(bits: &mut Bits<'_>, dc: Option<&Huffman>) -> Option<()> {
    let size = bits.symbol(dc?)?;
    if size > 15 { None } else { bits.skip(u32::from(size)) }
}

/// One block of a first scan over the coefficients `band` [T.81, Figure G.3].
fn first_ac(
    bits: &mut Bits<'_>,
    ac: Option<&Huffman>,
    band: (usize, usize),
    nonzero: &mut u64,
    eob_run: &mut u32,
) -> Option<()> {
    if *eob_run > 0 {
        *eob_run -= 1;
        return Some(());
    }
    let mut k = band.0;
    while k <= band.1 {
        let symbol = bits.symbol(ac?)?;
        let (run, size) = (u32::from(symbol >> 4), u32::from(symbol & 15));
        if size == 0 && run < 15 {
            *eob_run = (1 << run) + bits.take(run)? - 1;
            return Some(());
        }
        k += run as usize;
        if size > 0 {
            bits.skip(size)?;
            *nonzero |= 1u64.checked_shl(k as u32)?;
        }
        k += 1;
    }
    Some(())
}

/// One block of a scan that refines the coefficients `band` [T.81, Figure G.7].
fn refine_ac(
    bits: &mut Bits<'_>,
    ac: Option<&Huffman>,
    band: (usize, usize),
    nonzero: &mut u64,
    eob_run: &mut u32,
) -> Option<()> {
    let mut k = band.0;
    while *eob_run == 0 && k <= band.1 {
        let symbol = bits.symbol(ac?)?;
        let (mut run, size) = (u32::from(symbol >> 4), symbol & 15);
        if size == 0 && run < 15 {
            *eob_run = (1 << run) + bits.take(run)?;
            break;
        }
        if size > 0 {
            bits.skip(1)?; // the sign
        }
        // Every coefficient on the way that is not zero has its bit here; so many zeros are passed.
        while k <= band.1 {
            if *nonzero >> k & 1 == 1 {
                bits.skip(1)?;
            } else if run == 0 {
                if size > 0 {
                    *nonzero |= 1 << k;
                }
                break;
            } else {
                run -= 1;
            }
            k += 1;
        }
        k += 1;
    }
    if *eob_run > 0 {
        if k <= band.1 {
            let mask = (u64::MAX >> (63 - band.1)) & (u64::MAX << k);
            bits.skip((*nonzero & mask).count_ones())?;
        }
        *eob_run -= 1;
    }
    Some(())
}

/// Codes of at most 16 bits: for each 16 bits ahead the symbol and the length of its code, 0 for none.
struct Huffman(Vec<(u8, u8)>);

impl Huffman {
    /// From the numbers of codes of each length, and their symbols [T.81, Annex C].
    fn new(lengths: &[u8; 16], values: &[u8]) -> Option<Self> {
        let mut table = vec![(0, 0); 1 << 16];
        let (mut next, mut values) = (0usize, values.iter());
        for (i, &count) in lengths.iter().enumerate() {
            let span = 1 << (15 - i);
            for _ in 0..count {
                table.get_mut(next..next + span)?.fill((*values.next()?, i as u8 + 1));
                next += span;
            }
        }
        Some(Self(table))
    }
}

/// Entropy-coded bytes as bits, up to the next marker.
struct Bits<'a> {
    data: &'a [u8],
    /// The next byte to be taken.
    at: usize,
    buffer: u64,
    /// Bits in the buffer; those beyond the end of the data are zeros and count as negative in `left`.
    held: u32,
    /// Bits that are in the buffer and in the data.
    left: i64,
    ended: bool,
}

impl<'a> Bits<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self { data, at: 0, buffer: 0, held: 0, left: 0, ended: false }
    }

    /// Whether more was taken than is there.
    fn is_over(&self) -> bool {
        self.left < 0
    }

    fn fill(&mut self) {
        while self.held <= 56 {
            let mut byte = 0;
            if !self.ended {
                match (self.data.get(self.at), self.data.get(self.at + 1)) {
                    (Some(0xff), Some(0)) => {
                        byte = 0xff;
                        self.at += 2;
                    }
                    (Some(0xff), Some(0xff)) => {
                        self.at += 1; // fill bytes before a marker
                        continue;
                    }
                    (Some(0xff), _) | (None, _) => self.ended = true,
                    (Some(&b), _) => {
                        byte = b;
                        self.at += 1;
                    }
                }
            }
            self.left += if self.ended { 0 } else { 8 };
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.held += 8;
        }
    }

    fn symbol(&mut self, table: &Huffman) -> Option<u8> {
        if self.held < 16 {
            self.fill();
        }
        let (symbol, length) = table.0[(self.buffer >> (self.held - 16)) as usize & 0xffff];
        if length == 0 {
            // Zeros beyond the end may make a code that is none.
            self.left -= if self.left < 16 && self.ended { 17 } else { 0 };
            return None;
        }
        self.skip(u32::from(length))?;
        Some(symbol)
    }

    fn take(&mut self, count: u32) -> Option<u32> {
        if count == 0 {
            return Some(0);
        }
        if self.held < count {
            self.fill();
        }
        let value = (self.buffer >> (self.held - count)) as u32 & ((1u32 << count) - 1);
        self.skip(count)?;
        Some(value)
    }

    fn skip(&mut self, mut count: u32) -> Option<()> {
        // 63 bits of refinement are the most, 57 the least that a filled buffer holds.
        while count > 0 {
            if self.held < count.min(32) {
                self.fill();
            }
            let now = count.min(32);
            self.held -= now;
            self.left -= i64::from(now);
            count -= now;
        }
        (self.left >= 0).then_some(())
    }

    /// Goes behind the restart marker that must be next.
    fn restart(&mut self) -> Option<()> {
        let mut at = self.at;
        while let Some(pair) = self.data.get(at..at + 2) {
            match pair {
                [0xff, 0xd0..=0xd7] => {
                    *self = Self { at: at + 2, ..Self::new(self.data) };
                    return Some(());
                }
                [0xff, 0 | 0xff] => at += 1,
                [0xff, _] => return None,
                _ => at += 1,
            }
        }
        None
    }

    fn position(&self) -> usize {
        self.at
    }
}
