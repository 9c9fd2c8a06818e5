//! Paths and `use` declarations, read from tokens.

use proc_macro2::{Delimiter, Ident, TokenTree};

use crate::source::is_punct;

/// A path such as `crate::store::Index`, in a declaration, an expression, a type or a macro.
pub(crate) struct Mention {
    pub path: Vec<String>,
    pub line: usize,
}

/// A name that a `use` declaration brings into a module.
pub(crate) struct Import {
    /// The name, or nothing for `*`.
    pub name: Option<String>,
    pub path: Vec<String>,
    pub line: usize,
    /// Whether other modules may take it from here: `pub use` in any form.
    pub public: bool,
}

/// Reads the tokens between `use` and `;`.
pub(crate) fn imports(trees: &[TokenTree], public: bool) -> Vec<Import> {
    let mut found = Vec::new();
    use_tree(trees, &[], public, &mut found);
    found
}

fn use_tree(trees: &[TokenTree], prefix: &[String], public: bool, found: &mut Vec<Import>) {
    for part in trees.split(|tree| is_punct(Some(tree), ',')) {
        // `::name` is always another crate.
        if prefix.is_empty() && is_punct(part.first(), ':') {
            continue;
        }
        let mut path = prefix.to_vec();
        let mut name = None;
        let mut line = 0;
        let mut renames = false;
        for tree in part {
            match tree {
                TokenTree::Ident(word) if word == "as" => renames = true,
                TokenTree::Ident(word) => {
                    line = word.span().start().line;
                    name = Some(word.to_string());
                    if !renames && (word != "self" || path.is_empty()) {
                        path.push(word.to_string());
                    }
                }
                TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                    let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                    use_tree(&inner, &path, public, found);
                    line = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == '*' => {
                    line = punct.span().start().line;
                    name = None;
                }
                _ => {}
            }
        }
        if name.as_deref() == Some("self") {
            name = path.last().cloned();
        }
        if line > 0 {
            found.push(Import {
                name,
                path,
                line,
                public,
            });
        }
    }
}

/// Reads a path of two or more names that starts at a token. Returns it with the number of its tokens.
pub(crate) fn mention(trees: &[TokenTree]) -> Option<(Mention, usize)> {
    let first = ident(trees.first())?;
    let mut path = vec![first.to_string()];
    let mut length = 1;
    while is_punct(trees.get(length), ':') && is_punct(trees.get(length + 1), ':') {
        let Some(name) = ident(trees.get(length + 2)) else {
            break;
        };
        path.push(name.to_string());
        length += 3;
    }
    (path.len() > 1).then(|| {
        let line = first.span().start().line;
        (Mention { path, line }, length)
    })
}

fn ident(tree: Option<&TokenTree>) -> Option<&Ident> {
    match tree {
        Some(TokenTree::Ident(ident)) => Some(ident),
        _ => None,
    }
}
