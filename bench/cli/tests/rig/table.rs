/// The rows of the first table of a Markdown page. The tests of `host` have this file, too.
pub fn table<const COLUMNS: usize>(page: &'static str) -> Vec<[&'static str; COLUMNS]> {
    let (_, table) = page.split_once("|---|").unwrap();
    let rows = table.lines().skip(1).filter(|line| !line.is_empty());
    let cells = |line: &'static str| {
        let line = line.strip_prefix('|').unwrap().strip_suffix('|').unwrap();
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        cells.try_into().expect(line)
    };
    rows.map(cells).collect()
}
