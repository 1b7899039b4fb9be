//! The order of pictures by their names.

/// A key that sorts names as people count: `cat.2.png` before `cat.10.png`.
pub fn natural_key(name: &str) -> Vec<(u64, String)> {
    let mut key = vec![(0u64, String::new())];
    let mut in_digits = false;
    for c in name.chars() {
        let last = key.len() - 1;
        match c.to_digit(10) {
            Some(d) if in_digits => key[last].0 = key[last].0.saturating_mul(10).saturating_add(u64::from(d)),
            Some(d) => key.push((u64::from(d), String::new())),
            None => key[last].1.push(c),
        }
        in_digits = c.is_ascii_digit();
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_digits_count_as_numbers() {
        let mut names = ["IMG_10.jpg", "IMG_1.jpg", "IMG_02.jpg", "IMG_9b.jpg", "IMG_9.jpg"];
        names.sort_by_key(|n| natural_key(n));
        assert_eq!(names, ["IMG_1.jpg", "IMG_02.jpg", "IMG_9.jpg", "IMG_9b.jpg", "IMG_10.jpg"]);
    }
}
