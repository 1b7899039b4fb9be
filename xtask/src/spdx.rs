//! Licence expressions: `MIT OR (Apache-2.0 AND Unicode-3.0)`, with the old `MIT/Apache-2.0` for an OR.
//!
//! WITH binds tighter than AND, AND tighter than OR. "Or later" (`GPL-2.0+`) is part of a name.

/// Whether the user of something under `expression` can do with licences for which `allowed` holds. A licence with an
/// exception is asked for as `NAME WITH EXCEPTION`.
///
/// # Errors
/// The expression cannot be read.
pub(crate) fn is_satisfied(expression: &str, allowed: &dyn Fn(&str) -> bool) -> Result<bool, String> {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let mut words = spaced.split_whitespace().peekable();
    let value = alternatives(&mut words, allowed).filter(|_| words.next().is_none());
    value.ok_or_else(|| format!("cannot read the licence expression '{expression}'"))
}

type Words<'a, 'b> = &'b mut std::iter::Peekable<std::str::SplitWhitespace<'a>>;

fn alternatives(words: Words<'_, '_>, allowed: &dyn Fn(&str) -> bool) -> Option<bool> {
    let mut value = conjunction(words, allowed)?;
    while words.next_if_eq(&"OR").is_some() {
        value |= conjunction(words, allowed)?;
    }
    Some(value)
}

fn conjunction(words: Words<'_, '_>, allowed: &dyn Fn(&str) -> bool) -> Option<bool> {
    let mut value = licence(words, allowed)?;
    while words.next_if_eq(&"AND").is_some() {
        value &= licence(words, allowed)?;
    }
    Some(value)
}

fn licence(words: Words<'_, '_>, allowed: &dyn Fn(&str) -> bool) -> Option<bool> {
    match words.next()? {
        "(" => alternatives(words, allowed).filter(|_| words.next() == Some(")")),
        ")" | "OR" | "AND" | "WITH" => None,
        name if words.next_if_eq(&"WITH").is_some() => Some(allowed(&format!("{name} WITH {}", words.next()?))),
        name => Some(allowed(name)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(expression: &str) -> Option<bool> {
        is_satisfied(expression, &|name| ["MIT", "Zlib", "Apache-2.0 WITH LLVM-exception"].contains(&name)).ok()
    }

    #[test]
    fn operators_bind_as_the_standard_says() {
        assert_eq!(value("MIT"), Some(true));
        assert_eq!(value("GPL-3.0-only"), Some(false));
        assert_eq!(value("MIT OR GPL-3.0-only"), Some(true));
        assert_eq!(value("MIT AND GPL-3.0-only"), Some(false));
        assert_eq!(value("MIT OR GPL-3.0-only AND LGPL-2.1-only"), Some(true));
        assert_eq!(value("(MIT OR GPL-3.0-only) AND LGPL-2.1-only"), Some(false));
        assert_eq!(value("GPL-3.0-only AND LGPL-2.1-only OR Zlib"), Some(true));
        assert_eq!(value("MIT AND (GPL-3.0-only OR (Zlib))"), Some(true));
    }

    #[test]
    fn exceptions_and_old_spellings() {
        assert_eq!(value("Apache-2.0"), Some(false));
        assert_eq!(value("Apache-2.0 WITH LLVM-exception"), Some(true));
        assert_eq!(value("Apache-2.0 WITH LLVM-exception OR Apache-2.0"), Some(true));
        assert_eq!(value("GPL-2.0/MIT"), Some(true));
        assert_eq!(value("MIT+"), Some(false));
    }

    #[test]
    fn nonsense_is_refused() {
        for nonsense in ["", "MIT OR", "AND MIT", "(MIT", "MIT)", "MIT Zlib", "MIT WITH", "()", "MIT OR OR MIT"] {
            assert_eq!(value(nonsense), None, "{nonsense}");
        }
    }
}
