use super::*;

/// A row: `"V1","edr/a/    ","x.img ",  12` and the line end, 33 bytes.
const LABEL: &str = r#"PDS_VERSION_ID = PDS3
^INDEX_TABLE = "INDEX.TAB"
OBJECT = INDEX_TABLE
 INTERCHANGE_FORMAT = ASCII
 ROW_BYTES = 33
 ROWS = 2
 OBJECT = COLUMN
  NAME = VOLUME_ID
  START_BYTE = 2
  BYTES = 2
 END_OBJECT = COLUMN
 OBJECT = COLUMN
  NAME = PATH_NAME
  START_BYTE = 7
  BYTES = 10
 END_OBJECT = COLUMN
 OBJECT = COLUMN
  NAME = "FILE_NAME "
  START_BYTE = 19
  BYTES = 8
 END_OBJECT = COLUMN
 OBJECT = COLUMN
  NAME = PLANET_DAY_NUMBER
  START_BYTE = 28
  BYTES = 4
 END_OBJECT = COLUMN
END_OBJECT = INDEX_TABLE
END
"#;

fn row(volume: &str, path: &str, file: &str, sol: &str) -> String {
    let row = format!("\"{volume:2}\",\"{path:10}\",\"{file:6}\",{sol:>4}\r\n");
    assert_eq!(row.len(), 33, "{row:?}");
    row
}

fn index() -> Index {
    Index::from_label(LABEL.as_bytes()).unwrap()
}

fn read(index: &Index, table: &str) -> Result<Vec<ProductLocation>, String> {
    let rows = index.rows(table.as_bytes());
    rows.map(|row| row.map(|row| row.location()).map_err(|error| error.to_string()))
        .collect()
}

#[test]
fn rows_are_read_by_column() {
    let index = index();
    assert_eq!((index.file.as_deref(), index.rows), (Some("INDEX.TAB"), Some(2)));
    let table = row("V1", "edr/a/", "x.img", "12") + &row("V1", "/edr/b", "y.img", "-1");
    let rows: Vec<_> = index.rows(table.as_bytes()).map(Result::unwrap).collect();
    // The column of the file name begins before its quote and ends behind it: both are cut off.
    assert_eq!(
        (rows[0].text("FILE_NAME"), rows[0].text("NONE")),
        (Some("x.img"), None)
    );
    assert_eq!(
        rows[0].location(),
        ProductLocation {
            volume: Some("V1".into()),
            path: Some("edr/a".into()),
            file: Some("x.img".into()),
            sol: Some(12),
            ..ProductLocation::default()
        }
    );
    assert_eq!(
        (rows[1].location().path.as_deref(), rows[1].location().sol),
        (Some("edr/b"), None)
    );
}

#[test]
fn paths_that_lead_elsewhere_are_left_out() {
    let index = index();
    for (path, file) in [
        ("../a", "../x"),
        ("a/../..", "a/b"),
        ("a//b", ".."),
        ("a b", "a b"),
        ("UNK", "N/A"),
        ("", ""),
    ] {
        let table = row("V1", path, file, "1") + &row("V1", "a", "b", "1");
        let place = read(&index, &table).unwrap().remove(0);
        assert_eq!((place.path, place.file), (None, None), "{path} {file}");
    }
}

#[test]
fn a_row_of_another_length_is_an_error_with_its_number() {
    let index = index();
    let good = row("V1", "a", "b", "1");
    for (table, part) in [
        (
            format!("{good}{}", good.replace("\r\n", "\n")),
            "row 2: 32 bytes, its label says 33",
        ),
        (
            format!("{good}{}", &good[..20]),
            "row 2: 20 without line end bytes",
        ),
        (
            format!("{good}{}", good.replace("\r\n", "xx")),
            "row 2: 33 without line end bytes",
        ),
        (format!("\n{good}{good}"), "row 1: 1 bytes"),
        (format!("{good}{good}{good}"), "row 3: beyond the rows"),
        (good.clone(), "ends after 1 rows, its label says 2"),
        (String::new(), "ends after 0 rows"),
    ] {
        let error = read(&index, &table).unwrap_err();
        assert!(error.contains(part), "{table:?}: {error}");
    }
    // Nothing comes after an error.
    let mut rows = index.rows("no row\n".as_bytes());
    assert!(rows.next().is_some_and(|row| row.is_err()) && rows.next().is_none());
}

#[test]
fn an_error_of_the_disk_has_its_row() {
    struct Breaks;
    impl Read for Breaks {
        fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::ConnectionReset.into())
        }
    }
    let index = index();
    let good = row("V1", "a", "b", "1");
    let mut rows = index.rows(good.as_bytes().chain(Breaks));
    assert!(rows.next().unwrap().is_ok());
    let error = rows.next().unwrap().unwrap_err().to_string();
    assert!(
        error.starts_with("index table row 2: cannot be read: connection reset"),
        "{error}"
    );
}

#[test]
fn a_label_that_does_not_describe_its_rows_is_refused() {
    for (from, to, part) in [
        ("ROW_BYTES = 33", "ROW_BYTES = 33333333333", "ROW_BYTES"),
        ("ROW_BYTES = 33", "ROW_BYTES = 0", "ROW_BYTES"),
        ("ROW_BYTES = 33", "X = 34", "ROW_BYTES"),
        (
            "START_BYTE = 28",
            "START_BYTE = 32",
            "`PLANET_DAY_NUMBER` does not fit a row of 33 bytes",
        ),
        ("START_BYTE = 28", "START_BYTE = 0", "`PLANET_DAY_NUMBER`"),
        ("START_BYTE = 28", "START_BYTE = -1", "`PLANET_DAY_NUMBER`"),
        ("BYTES = 10", "BYTES = 9223372036854775807", "`PATH_NAME`"),
        ("ASCII", "BINARY", "BINARY"),
        ("COLUMN", "FIELD", "no table with columns"),
        ("END_OBJECT = INDEX_TABLE", "= =", "label line"),
    ] {
        let error = Index::from_label(LABEL.replace(from, to).as_bytes())
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{from} -> {to}: {error}");
    }
    assert!(matches!(
        Index::from_label(&vec![b' '; MAX_LABEL_BYTES + 1]),
        Err(IndexError::TooLarge(_))
    ));
}

#[test]
fn one_name_for_path_and_file_is_taken_apart() {
    let label = LABEL
        .replace("\"FILE_NAME \"", "FILE_SPECIFICATION_NAME")
        .replace("PATH_NAME", "OTHER");
    let index = Index::from_label(label.as_bytes()).unwrap();
    for (whole, path, file) in [
        ("a/b/c", Some("a/b"), Some("c")),
        ("A\\C.D", Some("A"), Some("C.D")),
        ("c", None, Some("c")),
    ] {
        let table = row("V1", "z", whole, "1") + &row("V1", "z", whole, "1");
        let place = read(&index, &table).unwrap().remove(0);
        assert_eq!(
            (place.path.as_deref(), place.file.as_deref()),
            (path, file),
            "{whole}"
        );
    }
}

/// The real label of Opportunity's index (933 bytes a row), with a row made here after its columns.
#[test]
fn the_real_index_label_is_read() {
    let Some(folder) = crate::testing::real("labels") else {
        return;
    };
    let label = std::fs::read(folder.join("edrindex.lbl")).unwrap();
    let mut index = Index::from_label(&label).unwrap();
    assert_eq!(
        (index.file.as_deref(), index.rows),
        (Some("EDRINDEX.TAB"), Some(203_550))
    );
    assert_eq!((index.columns.len(), index.row_bytes), (55, 933));
    let mut bytes = vec![b' '; 931];
    for (place, text) in [
        (2, "MER1NO_0XXX"),
        (66, "NAVCAM_LEFT"),
        (86, "\"data/navcam/site0070/"),
        (155, "1n491020834ilfcny9p0706l0m1.img"),
        (197, "1N491020834ILFCNY9P0706L0M1"),
        (289, "4093"),
        (881, "   112,"),
    ] {
        bytes[place - 1..place - 1 + text.len()].copy_from_slice(text.as_bytes());
    }
    bytes.extend_from_slice(b"\r\n");
    index.rows = Some(1);
    let rows: Vec<_> = index.rows(bytes.as_slice()).map(Result::unwrap).collect();
    assert_eq!(
        rows[0].location(),
        ProductLocation {
            volume: Some("MER1NO_0XXX".into()),
            path: Some("data/navcam/site0070".into()),
            file: Some("1n491020834ilfcny9p0706l0m1.img".into()),
            product: Some("1N491020834ILFCNY9P0706L0M1".into()),
            sol: Some(4093),
            instrument: Some("NAVCAM_LEFT".into()),
        }
    );
}
