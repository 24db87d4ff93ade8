"""The blocks of a report as Markdown."""

from catfree.viz.page._blocks import Heading, Notice, Paragraph, Picture, Table, to_markdown


def test_text_is_not_html():
    name = "<b>"
    rows = ((name,),)
    blocks = [Heading(name), Paragraph(name), Picture("a.png", name), Notice(name, (name,))]
    text = to_markdown([*blocks, Table(("camera",), rows)])
    assert text.count("<b>") == text.count("\\<b>") == 6
