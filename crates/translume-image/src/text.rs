//! Texts as people's programs write them: UTF-8, UTF-16 with or without a mark, Windows-1252; any line ends.

/// The text of a file, whatever its encoding, its lines ended by `\n`. What is no UTF-8 is taken for Windows-1252, in which
/// every byte is something: whether it makes sense is for its reader to say.
pub fn decode(bytes: &[u8]) -> String {
    let text = match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => match zeros(bytes) {
            [0, odd] if odd > 0 => utf16(bytes, u16::from_le_bytes),
            [even, 0] if even > 0 => utf16(bytes, u16::from_be_bytes),
            _ => std::str::from_utf8(bytes).map_or_else(|_| bytes.iter().map(|b| windows(*b)).collect(), str::to_owned),
        },
    };
    text.replace("\r\n", "\n").replace('\r', "\n")
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let units: Vec<u16> = bytes.as_chunks::<2>().0.iter().map(|b| unit(*b)).collect();
    String::from_utf16_lossy(&units)
}

/// Zero bytes in even and odd places: Latin text in UTF-16 without a mark has them in one of both.
fn zeros(bytes: &[u8]) -> [usize; 2] {
    let count = |odd: usize| bytes.iter().skip(odd).step_by(2).filter(|b| **b == 0).count();
    [count(0), count(1)]
}

fn windows(byte: u8) -> char {
    const FROM_80: [char; 32] = [
        '€', '\u{81}', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\u{8d}', 'Ž', '\u{8f}', '\u{90}', '‘',
        '’', '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\u{9d}', 'ž', 'Ÿ',
    ];
    match byte {
        0x80..=0x9f => FROM_80[usize::from(byte - 0x80)],
        _ => char::from(byte),
    }
}

/// A number, its decimal mark a point or a comma.
pub fn number(word: &str) -> Option<f32> {
    let comma = || word.split_once(',').filter(|(a, b)| !a.contains('.') && !b.contains(['.', ',']));
    word.parse().ok().or_else(|| comma().and_then(|(a, b)| format!("{a}.{b}").parse().ok()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoding_gives_the_same_text() {
        let text = "2\na ü.jpg 0 0 1\n";
        let utf16 = |unit: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(unit).collect::<Vec<u8>>();
        let crlf = text.replace('\n', "\r\n");
        for bytes in [
            text.as_bytes().to_vec(),
            [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            [&b"\xff\xfe"[..], &utf16(u16::to_le_bytes)].concat(),
            [&b"\xfe\xff"[..], &utf16(u16::to_be_bytes)].concat(),
            utf16(u16::to_le_bytes),
            utf16(u16::to_be_bytes),
            text.chars().map(|c| c as u8).collect(),
            crlf.into_bytes(),
            text.replace('\n', "\r").into_bytes(),
        ] {
            assert_eq!(decode(&bytes), text, "{bytes:?}");
        }
        assert_eq!(decode(b"\x80 \x93"), "€ “");
    }

    #[test]
    fn decimal_marks_are_points_or_commas() {
        for (word, value) in [
            ("0.5", Some(0.5)),
            ("-0,5", Some(-0.5)),
            ("1e-2", Some(0.01)),
            ("1,000.5", None),
            ("1,2,3", None),
            (",", None),
        ] {
            assert_eq!(number(word), value, "{word}");
        }
    }
}
