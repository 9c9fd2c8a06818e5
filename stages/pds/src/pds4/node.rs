//! Access to the elements of a label by namespace and path.

use roxmltree::Node;

use crate::values;

pub(super) const PDS: &str = "http://pds.nasa.gov/pds4/pds/v1";
pub(super) const IMG: &str = "http://pds.nasa.gov/pds4/img/v1";

pub(super) fn child<'a, 'd>(node: Node<'a, 'd>, namespace: &str, name: &str) -> Option<Node<'a, 'd>> {
    node.children()
        .find(|child| child.has_tag_name((namespace, name)))
}

pub(super) fn children<'a, 'd>(
    node: Node<'a, 'd>,
    namespace: &'a str,
    name: &'a str,
) -> impl Iterator<Item = Node<'a, 'd>> {
    node.children()
        .filter(move |child| child.has_tag_name((namespace, name)))
}

pub(super) fn at<'a, 'd>(node: Node<'a, 'd>, path: &[(&str, &str)]) -> Option<Node<'a, 'd>> {
    path.iter()
        .try_fold(node, |node, (namespace, name)| child(node, namespace, name))
}

pub(super) fn text_at(node: Node<'_, '_>, path: &[(&str, &str)]) -> Option<String> {
    values::known(at(node, path)?.text()?)
}

pub(super) fn number_at(node: Node<'_, '_>, path: &[(&str, &str)]) -> Option<f64> {
    values::number(at(node, path)?.text()?)
}
