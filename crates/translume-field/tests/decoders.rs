//! Blocks as other programs decode them: `data/blocks.txt` holds random blocks of every mode with the values of imagecodecs (bcdec), which
//! Pillow and texture2ddecoder agreed with when `benches/field/independent.py blocks` wrote it.

use translume_field::texture::{Codec, Texture};

#[test]
fn blocks_decode_to_what_other_decoders_say() {
    let mut seen = std::collections::BTreeMap::new();
    for line in include_str!("data/blocks.txt").lines().filter(|l| !l.starts_with('#')) {
        let words: Vec<&str> = line.split(' ').collect();
        // The most by which a value may differ, in 65535ths: decoders round BC1 and BC4 to 8 bits, some of them down; patterns of half
        // floats are exact, but for 16-bit codes of them.
        let (codec, scale, most) = match words[0] {
            "bc1" => (Codec::Bc1, 255.0, 257.0),
            "bc4" => (Codec::Bc4, 255.0, 257.0),
            "bc6h" => (Codec::Bc6h, 31743.0, 0.51),
            "bc7" => (Codec::Bc7, 255.0, 0.51),
            other => panic!("{other}"),
        };
        let byte = |i: usize| u8::from_str_radix(&words[1][2 * i..2 * i + 2], 16).unwrap();
        let data: Vec<u8> = (0..words[1].len() / 2).map(byte).collect();
        let texture = Texture { codec, data, low: [0.0; 3], high: [1.0; 3] };
        let planes = texture.decode(4, 4).unwrap();
        let expected = words[2..].iter().map(|w| w.parse::<f64>().unwrap() / scale * 65535.0);
        assert_eq!(words.len() - 2, 16 * planes.len());
        for (got, expected) in planes.concat().iter().zip(expected) {
            assert!((f64::from(*got) - expected).abs() <= most, "{line}: {planes:?}");
        }
        *seen.entry(words[0]).or_insert(0) += 1;
    }
    assert!(seen.len() == 4 && seen.values().all(|n| *n == 48), "{seen:?}");
}
