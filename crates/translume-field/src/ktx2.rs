//! KTX 2.0 textures (Khronos, version 2.0.4), as much of it as fields need: two-dimensional arrays without mip levels,
//! nothing supercompressed. Other programs read what is written here; read back are only the same formats.

use crate::texture::Codec;

const IDENTIFIER: [u8; 12] = [0xab, b'K', b'T', b'X', b' ', b'2', b'0', 0xbb, b'\r', b'\n', 0x1a, b'\n'];
/// Identifier, header, index, and the one entry of the level index.
const LEVEL_END: usize = 12 + 36 + 32 + 24;

/// Vulkan's number of a codec's format, the colour model of its data format descriptor, and the bits of its samples.
fn format(codec: Codec) -> (u32, u8, &'static [u32]) {
    match codec {
        Codec::R8 => (9, 1, &[8]),
        Codec::R16 => (70, 1, &[16]),
        Codec::Rgb8 => (23, 1, &[8, 8, 8]),
        Codec::Bc1 => (131, 128, &[64]),
        Codec::Bc4 => (139, 131, &[64]),
        Codec::Bc6h => (143, 133, &[128]),
        Codec::Bc7 => (145, 134, &[128]),
    }
}

const CODECS: [Codec; 7] = [Codec::R8, Codec::R16, Codec::Rgb8, Codec::Bc1, Codec::Bc4, Codec::Bc6h, Codec::Bc7];

fn is_blocks(codec: Codec) -> bool {
    !matches!(codec, Codec::R8 | Codec::R16 | Codec::Rgb8)
}

/// What is before the data of a texture array of so many `layers`, each of the codec's bytes for `width × height`.
pub(crate) fn header(codec: Codec, (width, height): (usize, usize), layers: usize) -> Vec<u8> {
    let (vk_format, ..) = format(codec);
    let descriptor = descriptor(codec);
    // Values start at a multiple of the size of a block, and of 4.
    let align = if is_blocks(codec) { codec.bytes(4, 4) } else { 12 };
    let start = (LEVEL_END + descriptor.len()).next_multiple_of(align);
    let length = layers * codec.bytes(width, height);
    let mut out = Vec::with_capacity(start);
    out.extend(IDENTIFIER);
    let layer_count = layers as u32;
    let type_size = if codec == Codec::R16 { 2 } else { 1 };
    for v in [vk_format, type_size, width as u32, height as u32, 0, layer_count, 1, 1, 0] {
        out.extend(v.to_le_bytes());
    }
    for v in [LEVEL_END as u32, descriptor.len() as u32, 0, 0] {
        out.extend(v.to_le_bytes());
    }
    for v in [0u64, 0, start as u64, length as u64, length as u64] {
        out.extend(v.to_le_bytes());
    }
    out.extend(descriptor);
    out.resize(start, 0);
    out
}

/// The data format descriptor: one basic block with the colour model and a sample for each channel (for each block of a
/// block codec).
fn descriptor(codec: Codec) -> Vec<u8> {
    let (_, model, samples) = format(codec);
    let block = 24 + 16 * samples.len();
    let mut out = Vec::new();
    out.extend(((4 + block) as u32).to_le_bytes());
    out.extend(0u32.to_le_bytes());
    out.extend(2u16.to_le_bytes());
    out.extend((block as u16).to_le_bytes());
    // Primaries of Rec. 709, linear, straight alpha.
    out.extend([model, 1, 1, 0]);
    let last = if is_blocks(codec) { 3 } else { 0 };
    out.extend([last, last, 0, 0]);
    let bytes: u32 = samples.iter().sum::<u32>() / 8;
    out.extend([bytes as u8, 0, 0, 0, 0, 0, 0, 0]);
    for (i, bits) in samples.iter().enumerate() {
        out.extend(((8 * i) as u16).to_le_bytes());
        // BC6H is the one of floats: its range is written as that of floats, 0 to 1.
        let float = codec == Codec::Bc6h;
        out.extend([(bits - 1) as u8, i as u8 | if float { 0x80 } else { 0 }, 0, 0, 0, 0]);
        let upper = match codec {
            _ if float => 1f32.to_bits(),
            _ if is_blocks(codec) => u32::MAX,
            _ => (1 << bits) - 1,
        };
        out.extend(0u32.to_le_bytes());
        out.extend(upper.to_le_bytes());
    }
    out
}

/// What a texture array holds: codec, width, height, and the bytes of each layer.
pub(crate) type Array<'a> = (Codec, (usize, usize), Vec<&'a [u8]>);

/// Reads a texture array that follows such a [`header`].
pub(crate) fn read(file: &[u8]) -> Result<Array<'_>, String> {
    let cut = || "the texture ends early (truncated)".to_owned();
    let u32_at = |at: usize| {
        let bytes = file.get(at..at + 4).and_then(|b| b.try_into().ok()).ok_or_else(cut)?;
        Ok::<_, String>(u32::from_le_bytes(bytes))
    };
    let u64_at = |at: usize| Ok::<_, String>(u64::from(u32_at(at)?) | u64::from(u32_at(at + 4)?) << 32);
    if !file.starts_with(&IDENTIFIER) {
        return Err("not a KTX2 texture".into());
    }
    let number = u32_at(12)?;
    let codec = CODECS.into_iter().find(|c| format(*c).0 == number);
    let codec = codec.ok_or_else(|| format!("a texture of Vulkan format {number}, which fields do not have"))?;
    let (width, height) = (u32_at(20)?, u32_at(24)?);
    let (depth, layers, faces, levels, scheme) = (u32_at(28)?, u32_at(32)?, u32_at(36)?, u32_at(40)?, u32_at(44)?);
    if depth != 0 || faces != 1 || levels != 1 || scheme != 0 || width == 0 || height == 0 {
        return Err("a texture that is no plain two-dimensional array".into());
    }
    if u64::from(width) * u64::from(height) > 1 << 31 {
        return Err(format!("a texture of {width} × {height} texels"));
    }
    let size = (width as usize, height as usize);
    let (start, length) = (u64_at(80)?, u64_at(88)?);
    let one = codec.bytes(size.0, size.1);
    let layers = (layers as usize).max(1);
    let end = start.checked_add(length).and_then(|e| usize::try_from(e).ok());
    let data = end.and_then(|e| file.get(start as usize..e)).ok_or_else(cut)?;
    if one.checked_mul(layers) != Some(data.len()) {
        return Err(format!("{} bytes of data for {layers} layers of {one}", data.len()));
    }
    Ok((codec, size, data.chunks(one).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(codec: Codec, size: (usize, usize), layers: &[&[u8]]) -> Vec<u8> {
        [header(codec, size, layers.len()), layers.concat()].concat()
    }

    #[test]
    fn arrays_come_back_and_damage_is_an_error() {
        for codec in CODECS {
            let one = codec.bytes(9, 5);
            let layers: Vec<Vec<u8>> = (0..3).map(|j| (0..one).map(|i| (i * 7 + j) as u8).collect()).collect();
            let layers: Vec<&[u8]> = layers.iter().map(|l| &l[..]).collect();
            let file = write(codec, (9, 5), &layers);
            assert_eq!(read(&file).unwrap(), (codec, (9, 5), layers));
            for cut in 0..file.len() {
                assert!(read(&file[..cut]).is_err(), "{codec:?} {cut}");
            }
            // No header can make it panic or take memory.
            for at in 0..LEVEL_END.min(file.len()) {
                for value in [0, 0x7f, 0xff] {
                    let mut damaged = file.clone();
                    damaged[at] = value;
                    let _ = read(&damaged);
                }
            }
        }
    }

    /// The reader of others finds the same in it.
    #[test]
    fn another_reader_opens_it() {
        for codec in CODECS {
            let layer: Vec<u8> = (0..codec.bytes(9, 5)).map(|i| (i * 7) as u8).collect();
            let file = write(codec, (9, 5), &[&layer, &layer]);
            let reader = ktx2::Reader::new(&file[..]).unwrap();
            let header = reader.header();
            assert_eq!((header.pixel_width, header.pixel_height, header.layer_count), (9, 5, 2));
            assert_eq!(header.format.map(|f| f.value()), Some(format(codec).0));
            let levels: Vec<_> = reader.levels().collect();
            assert!(levels.len() == 1 && levels[0].data == [&layer[..], &layer[..]].concat(), "{codec:?}");
        }
    }

    #[test]
    fn the_header_is_the_one_of_the_specification() {
        let file = write(Codec::Bc4, (8, 4), &[&[1; 16], &[2; 16]]);
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap());
        // vkFormat BC4_UNORM, typeSize, size, depth, layers, faces, levels, no supercompression.
        assert_eq!([12, 16, 20, 24, 28, 32, 36, 40, 44].map(word), [139, 1, 8, 4, 0, 2, 1, 1, 0]);
        let (dfd, length) = (word(48) as usize, word(52));
        assert_eq!((word(dfd), length), (length, 4 + 24 + 16));
        // BC4's colour model, blocks of 4 × 4 texels and 8 bytes, one sample of 64 bits.
        assert_eq!(file[dfd + 12..dfd + 24], [131, 1, 1, 0, 3, 3, 0, 0, 8, 0, 0, 0]);
        assert_eq!(file[dfd + 30], 63);
        assert_eq!(word(80) % 8, 0);
    }
}
