// Text for people: how wide the terminal is, and lines that fit it.
#pragma once

#include <cstddef>
#include <cstdio>
#include <string>
#include <string_view>
#include <vector>

namespace saltus {

// For whom text is laid out.
struct TextLayout {
  size_t width = 100;   // columns; nothing is ever cut off, but what cannot be broken may stick out
  bool colour = false;  // ANSI escapes show tones
};

// Of standard output: $COLUMNS columns if that is set, else those of the terminal, else 100; colour on a terminal,
// unless NO_COLOR is set.
TextLayout LayoutOfStandardOutput();

// Columns of the terminal that `sink` writes to; nothing is asked of the environment.
size_t TerminalColumns(std::FILE* sink, size_t if_none);

// The words one after the other, each within `quote`.
std::string Joined(const std::vector<std::string>& words, std::string_view separator = ", ",
                   std::string_view quote = "");
// The same in backquotes; "none" if there are none.
std::string JoinedNames(const std::vector<std::string>& names);

// Columns that UTF-8 text takes, were every code point one column wide.
size_t DisplayWidth(std::string_view text);

// `text` in lines of at most `width` columns, broken between words, and within those that are wider. Line feeds break
// too. At least one line. Precondition: width > 0.
std::vector<std::string> WrapText(std::string_view text, size_t width);

// The same as one text, each line after `indent` spaces and ended by a line feed. The first line has `label` in that
// space; it stands on a line of its own if it is too long.
std::string Paragraph(std::string_view text, size_t width, size_t indent = 0, std::string_view label = "");

}  // namespace saltus
