//! Tokens of a page: tags, hrefs and text, in one pass. Reads only as much of HTML as folder listings need.

/// A token of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Token<'a> {
    /// Text between two tags.
    Text(&'a [u8]),
    /// `<name …>`.
    Open(Tag<'a>),
    /// `</name>`.
    Close(&'a [u8]),
}

/// A start tag.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tag<'a> {
    /// Name as written.
    pub name: &'a [u8],
    /// Value of its first `href`, as written.
    pub href: Option<&'a [u8]>,
}

/// Returns the tokens of a page without comments, declarations, scripts and styles.
pub(super) fn tokens(page: &[u8]) -> Tokens<'_> {
    Tokens {
        page,
        at: 0,
        cut: false,
    }
}

/// See [`tokens`]. Every byte is read a bounded number of times: an unclosed part extends to the end of the page.
pub(super) struct Tokens<'a> {
    page: &'a [u8],
    at: usize,
    cut: bool,
}

impl<'a> Tokens<'a> {
    /// Whether the page ended inside a tag, a comment or a script.
    pub fn is_cut(&self) -> bool {
        self.cut
    }

    fn rest(&self) -> &'a [u8] {
        self.page.get(self.at..).unwrap_or_default()
    }

    fn peek(&self) -> Option<u8> {
        self.page.get(self.at).copied()
    }

    fn take_while(&mut self, wanted: impl Fn(u8) -> bool) -> &'a [u8] {
        let rest = self.rest();
        let length = rest.iter().position(|byte| !wanted(*byte)).unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    /// Moves past the next `end`, in either case, or to the end of the page if there is none.
    fn skip_past(&mut self, end: &[u8]) {
        let found = self
            .rest()
            .windows(end.len())
            .position(|window| window.eq_ignore_ascii_case(end));
        self.cut |= found.is_none();
        self.at = found.map_or(self.page.len(), |found| self.at + found + end.len());
    }

    /// Reads attributes up to `>` and returns the first href.
    fn attributes(&mut self) -> Option<&'a [u8]> {
        let mut href = None;
        loop {
            self.take_while(|byte| byte.is_ascii_whitespace() || byte == b'/');
            match self.peek() {
                None => {
                    self.cut = true;
                    return None;
                }
                Some(b'>') => {
                    self.at += 1;
                    return href;
                }
                Some(_) => {}
            }
            // At least one byte is taken: the next is not a blank, `/` or `>`, and a `=` is taken below.
            let name = self.take_while(|byte| !byte.is_ascii_whitespace() && !b"=>/".contains(&byte));
            self.take_while(|byte| byte.is_ascii_whitespace());
            let value = if self.peek() == Some(b'=') {
                self.at += 1;
                Some(self.value())
            } else {
                None
            };
            if name.eq_ignore_ascii_case(b"href") && href.is_none() {
                href = value;
            }
        }
    }

    /// Reads the value after `=`, without its quotes.
    fn value(&mut self) -> &'a [u8] {
        self.take_while(|byte| byte.is_ascii_whitespace());
        match self.peek() {
            Some(quote @ (b'"' | b'\'')) => {
                self.at += 1;
                let value = self.take_while(|byte| byte != quote);
                self.at += 1;
                value
            }
            _ => self.take_while(|byte| !byte.is_ascii_whitespace() && byte != b'>'),
        }
    }
}

impl<'a> Iterator for Tokens<'a> {
    type Item = Token<'a>;

    fn next(&mut self) -> Option<Token<'a>> {
        while self.at < self.page.len() {
            if self.peek() != Some(b'<') {
                return Some(Token::Text(self.take_while(|byte| byte != b'<')));
            }
            let rest = self.rest();
            match rest.get(1) {
                Some(b'!' | b'?') if rest.starts_with(b"<!--") => {
                    self.at += 4;
                    self.skip_past(b"-->");
                }
                Some(b'!' | b'?') => self.skip_past(b">"),
                Some(b'/') => {
                    self.at += 2;
                    let name = self.take_while(|byte| byte.is_ascii_alphanumeric());
                    self.skip_past(b">");
                    return Some(Token::Close(name));
                }
                Some(letter) if letter.is_ascii_alphabetic() => {
                    self.at += 1;
                    let name = self.take_while(|byte| byte.is_ascii_alphanumeric());
                    let href = self.attributes();
                    for hidden in [&b"script"[..], b"style"] {
                        if name.eq_ignore_ascii_case(hidden) {
                            self.skip_past(&[b"</", hidden].concat());
                            self.skip_past(b">");
                        }
                    }
                    return Some(Token::Open(Tag { name, href }));
                }
                // A lone `<` is text.
                _ => {
                    self.at += 1;
                    return Some(Token::Text(&rest[..1]));
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hrefs(page: &str) -> (Vec<String>, bool) {
        let mut tokens = tokens(page.as_bytes());
        let found = tokens.by_ref().filter_map(|token| match token {
            Token::Open(tag) => Some(String::from_utf8_lossy(tag.href?).into_owned()),
            _ => None,
        });
        let found = found.collect();
        (found, tokens.is_cut())
    }

    #[test]
    fn hrefs_are_read_with_any_quotes_and_case() {
        let page = "<A HREF='a'>x</A><a class=b href = c/ >x</a><a href=\"d\" href=\"e\"><a href><br/><a\nhref\n=\n\"f\">";
        assert_eq!(
            hrefs(page),
            (["a", "c/", "d", "f"].map(str::to_owned).to_vec(), false)
        );
    }

    #[test]
    fn what_is_hidden_is_left_out() {
        let page = "<!-- <a href=a> --><!DOCTYPE html><?php x ?><script>'<a href=b>'</SCRIPT ><style><a href=c></style>\
                    3 < 4 <a href=d>";
        assert_eq!(hrefs(page), (vec!["d".to_owned()], false));
    }

    #[test]
    fn what_does_not_end_is_cut() {
        for page in [
            "<a href=x",
            "<a href=\"x",
            "<!-- ",
            "<script>",
            "<script></script",
            "</a",
            "<!DOCTYPE",
            "<a href=",
        ] {
            let (found, cut) = hrefs(page);
            assert!(cut && found.is_empty(), "{page}: {found:?}");
        }
    }
}
