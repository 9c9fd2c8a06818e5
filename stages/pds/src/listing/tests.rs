use super::*;

const TABLE: &str = r#"<html><body><h1>Index of /img/data/mars2020/demo/browse/sol/00012/ids/edr/zcam</h1><table>
<tr><th><a href="?C=N;O=D">Name</a></th><th><a href="?C=M;O=A">Last modified</a></th><th><a href="?C=S;O=A">Size</a></th></tr>
<tr><td><img alt="[PARENTDIR]"></td><td><a href="/img/data/mars2020/demo/browse/sol/00012/ids/edr/">Parent Directory</a></td><td>&nbsp;</td><td>  - </td></tr>
<tr><td><a href="ZL0_0012_0668000000_100EBY_N0030000ZCAM00001_0340LMJ01.png"><img alt="[IMG]"></a></td><td><a href="ZL0_0012_0668000000_100EBY_N0030000ZCAM00001_0340LMJ01.png">ZL0_0012_0668000000_100EBY_N00..&gt;</a></td><td align="right">2022-03-01 10:20  </td><td align="right">3.1M</td></tr>
<tr><td><a href="older/">older/</a></td><td align="right">  </td><td align="right">  - </td></tr>
</table></body></html>
"#;

const PRE: &str = "<HTML><HEAD><TITLE>Index of /demo</TITLE></HEAD><BODY><PRE>\
    <IMG SRC='/icons/blank.gif'> <A HREF='?C=N;O=D'>Name</A>   <A HREF='?C=M;O=A'>Last modified</A><HR>\n\
    <IMG SRC='/icons/back.gif'> <A HREF='/demo/..'>Parent Directory</A>   27-Feb-2021 08:00    -\n\
    <IMG SRC='/icons/folder.gif'> <A HREF='00012/'>00012/</A>   28-Feb-2021 09:05    -\n\
    <IMG SRC='/icons/image2.gif'> <A HREF=b.IMG>b.IMG</A>   01-Mar-2022 10:20  3.8M\n\
    <HR></PRE></BODY></HTML>";

fn entry(name: &str, folder: bool, modified: Option<&str>) -> Entry {
    Entry {
        name: name.to_owned(),
        folder,
        modified: modified.map(str::to_owned),
    }
}

fn index_of(body: &str) -> String {
    format!("<h1>Index of /x</h1><pre>{body}</pre>")
}

fn names(body: &str) -> Vec<String> {
    let entries = read(index_of(body).as_bytes()).unwrap();
    entries.into_iter().map(|entry| entry.name).collect()
}

#[test]
fn a_table_is_read_once_per_name() {
    let png = "ZL0_0012_0668000000_100EBY_N0030000ZCAM00001_0340LMJ01.png";
    assert_eq!(
        read(TABLE.as_bytes()).unwrap(),
        [
            entry(png, false, Some("2022-03-01T10:20")),
            entry("older", true, None)
        ]
    );
}

#[test]
fn lines_with_upper_case_tags_and_other_quotes_are_read() {
    assert_eq!(
        read(PRE.as_bytes()).unwrap(),
        [
            entry("00012", true, Some("2021-02-28T09:05")),
            entry("b.IMG", false, Some("2022-03-01T10:20")),
        ]
    );
}

#[test]
fn an_empty_folder_is_no_error() {
    let empty = "<html><head><title>Index of /x</title></head><body><h1>Index of /x</h1><ul>\
                 <li><a href=\"/\"> Parent Directory</a></li></ul></body></html>";
    assert_eq!(read(empty.as_bytes()).unwrap(), []);
    // Some servers leave the heading out.
    assert_eq!(read(b"<table><a href=\"?C=N;O=D\">Name</a></table>").unwrap(), []);
}

#[test]
fn another_page_is_an_error() {
    for page in [
        "",
        "\0",
        "403 Forbidden",
        "<html><body><h1>Request blocked</h1><pre><a href=\"a.png\">x</a></pre></body></html>",
        "<html><body>Index of <table><a href=\"a.png\">x</a></table></body></html>",
        "<h1>Index of /x</h1>",
    ] {
        assert_eq!(
            read(page.as_bytes()),
            Err(ListingError::NoListing(page.len())),
            "{page}"
        );
    }
}

#[test]
fn no_cut_of_a_page_is_taken_for_the_folder() {
    for page in [TABLE, PRE] {
        let lower = page.to_ascii_lowercase();
        let end = ["</table>", "</pre>"]
            .iter()
            .filter_map(|end| Some(lower.find(end)? + end.len()))
            .max()
            .unwrap();
        for cut in 0..end {
            read(&page.as_bytes()[..cut]).unwrap_err();
        }
        assert_eq!(read(&page.as_bytes()[..end]), read(page.as_bytes()));
    }
}

#[test]
fn only_plain_relative_names_are_taken() {
    for href in [
        "?C=N;O=D",
        "/",
        "/a.png",
        "//evil/a.png",
        ".",
        "..",
        "./",
        "../",
        "../a.png",
        "a/b.png",
        "a//",
        "a/../",
        "%2e%2e",
        "a%00.png",
        "a&amp;b.png",
        "&#46;&#46;",
        "a&#95;.png",
        "http://h/a.png",
        "a.png?x",
        "a.png#x",
        "a b.png",
        " a.png",
        "a\\b.png",
        "C:a.png",
        "$(x).png",
        "é.png",
        "",
        "a;b",
        "x:y",
        "\u{202e}gnp.exe",
    ] {
        assert_eq!(names(&format!("<a href=\"{href}\">x</a>")), [""; 0], "{href}");
    }
    let long = "x".repeat(256);
    assert_eq!(names(&format!("<a href=\"{long}\">x</a>")), [""; 0]);
    assert_eq!(
        names("<a href=-rf.png><a href='b/'><a href=\"A.PNG\"><a href=a.png><a href=a.png/>"),
        ["-rf.png", "A.PNG", "a.png", "b"]
    );
}

#[test]
fn the_text_of_a_link_gives_neither_name_nor_time() {
    let page = index_of(
        "<a href=a.png>2021-01-01 00:00 b.png</a> 2022-03-01 10:20 <a href=/x>x</a> 2023-01-01 00:00",
    );
    assert_eq!(
        read(page.as_bytes()).unwrap(),
        [entry("a.png", false, Some("2022-03-01T10:20"))]
    );
}

#[test]
fn pages_and_counts_without_end_are_refused() {
    let large = vec![b' '; MAX_PAGE_BYTES + 1];
    assert_eq!(read(&large), Err(ListingError::TooLarge(large.len())));
    let many: String = (0..=MAX_ENTRIES)
        .map(|index| format!("<a href=f{index}>"))
        .collect();
    assert_eq!(read(index_of(&many).as_bytes()), Err(ListingError::TooMany));
}

#[test]
fn the_hostile_pages_give_plain_names_or_an_error() {
    let Some(folder) = crate::testing::real("bad-inputs/own") else {
        return;
    };
    let hostile = std::fs::read_to_string(folder.join("index_hostile.html")).unwrap();
    assert_eq!(
        read(hostile.as_bytes()),
        Err(ListingError::NoListing(hostile.len()))
    );
    assert_eq!(names(&hostile), ["-rf.png", ".png", "A.PNG", "CON.png", "a.png"]);
    for (file, error) in [
        ("index_unclosed.html", ListingError::NoListing(900_000)),
        ("index_1e6_links.html", ListingError::TooLarge(26_888_890)),
        ("html_404.jpg", ListingError::NoListing(0)),
    ] {
        let page = std::fs::read(folder.join(file)).unwrap();
        let found = read(&page).unwrap_err();
        assert_eq!(
            std::mem::discriminant(&found),
            std::mem::discriminant(&error),
            "{file}: {found}"
        );
    }
}
