// Tables, built once and written as Markdown, CSV or text that fits a terminal, and the layout of text.
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

namespace saltus {

// The width and colours for which text is laid out.
struct TextLayout {
  size_t width = 100;   // columns; nothing is ever cut off, but what cannot be broken may stick out
  bool colour = false;  // ANSI escapes show tones
};

// Returns the layout of standard output: $COLUMNS columns if that is set, else those of the terminal, else 100; colour
// on a terminal, unless NO_COLOR is set.
TextLayout LayoutOfStandardOutput();

// Returns the columns of the terminal that `sink` writes to, `if_none` if it is no terminal; ignores the environment.
size_t TerminalColumns(std::FILE* sink, size_t if_none);

// Joins words, each within `quote`.
std::string Joined(const std::vector<std::string>& words, std::string_view separator = ", ",
                   std::string_view quote = "");
// Joins names in backquotes; "none" if there are none.
std::string JoinedNames(const std::vector<std::string>& names);

// Returns the columns of UTF-8 text, if every code point is one column wide.
size_t DisplayWidth(std::string_view text);

// Returns the bytes of the characters that fit into so many columns; characters are never split.
size_t PrefixOf(std::string_view text, size_t columns);

// Returns `text` in lines of at most `width` columns, broken between words, at line feeds, and within words that are
// wider. There is at least one line. Precondition: width > 0.
std::vector<std::string> WrapText(std::string_view text, size_t width);

// Returns wrapped text as a paragraph: each line after `indent` spaces, with a line feed at its end. The first line has
// `label` in that space; a label that is too long has its own line.
std::string Paragraph(std::string_view text, size_t width, size_t indent = 0, std::string_view label = "");

// The tone of a cell beyond its value: a colour on a terminal and in pages.
enum class Tone { kPlain, kGood, kWarning, kBad, kMuted };

// Returns "good", "warning", "bad", "muted", or "" for a plain one.
std::string_view ToneName(Tone tone);

// A cell: text, a number, or empty.
class Cell {
 public:
  Cell() = default;
  Cell(std::string text) : value_(std::move(text)) {}         // NOLINT: implicit, so that rows read as lists of values
  Cell(std::string_view text) : value_(std::string(text)) {}  // NOLINT
  Cell(const char* text) : value_(std::string(text)) {}       // NOLINT
  template <std::floating_point T>
  Cell(T number) : value_(static_cast<double>(number)) {}  // NOLINT
  template <std::integral T>
  requires(!std::same_as<T, bool>) Cell(T number) : value_(static_cast<int64_t>(number)) {}  // NOLINT
  template <typename T>
  Cell(const std::optional<T>& value) : Cell(value ? Cell(*value) : Cell()) {}  // NOLINT

  Cell& WithTone(Tone tone) {
    tone_ = tone;
    return *this;
  }

  // Displays the number with so many digits, whatever its column has.
  Cell& WithDigits(int significant_digits) {
    significant_digits_ = significant_digits;
    return *this;
  }

  Tone tone() const { return tone_; }
  std::optional<int> significant_digits() const { return significant_digits_; }
  bool IsText() const { return std::holds_alternative<std::string>(value_); }

  // Returns the cell for people: floating-point numbers with at most `significant_digits`; empty if there is nothing.
  std::string Display(int significant_digits) const;

  // Returns the cell for programs: floating-point numbers with the fewest digits that read back as the same double.
  std::string Exact() const;

 private:
  std::variant<std::monostate, std::string, int64_t, double> value_;
  Tone tone_ = Tone::kPlain;
  std::optional<int> significant_digits_;
};

struct Column {
  std::string header;
  int significant_digits = 6;  // of floating-point numbers when displayed; CSV has all digits
};

// Returns the columns of a text such as "contact; loss:8": their headers, separated by "; ", each with the number of
// digits after a colon, if it is not the usual one.
std::vector<Column> ColumnsOf(std::string_view text);

class Table {
 public:
  // The first `keys` columns name a row: text repeats them wherever a row goes on below.
  // Precondition: 1 <= keys <= columns.
  explicit Table(std::vector<Column> columns, size_t keys = 1);

  // Precondition: one cell a column.
  void AddRow(std::vector<Cell> row);

  const std::vector<Column>& columns() const { return columns_; }
  const std::vector<std::vector<Cell>>& rows() const { return rows_; }

  size_t keys() const { return keys_; }

  // Whether a column has numbers only; it is then aligned to the right.
  bool IsNumeric(size_t column) const;
  // Returns a cell for people.
  std::string Display(size_t row, size_t column) const;
  // Returns the keys, and the other columns that are not empty in every row.
  std::vector<size_t> ColumnsWithContent() const;

  // Returns GitHub-flavoured Markdown, padded so that the source is readable too.
  std::string ToMarkdown() const;

  // Returns RFC 4180 text with a header line; lines end in a bare line feed.
  std::string ToCsv() const;

  // Returns aligned columns without those that have no content. If they are too wide, texts are wrapped, and the
  // columns that still do not fit follow below, after the keys once more.
  std::string ToText(const TextLayout& layout = {}) const;

  // Whether the text has every row on one line.
  bool FitsOneLine(size_t width) const;

  // Rows become columns and columns rows: each of these begins with the header of its column, under `corner`, and each
  // of those has the first cell of its row for a header. The first `keys` columns are keys.
  Table Transposed(std::string corner, size_t keys) const;

 private:
  // A column of the text, with the widths that do not depend on its neighbours.
  struct TextColumn {
    size_t index = 0;
    size_t natural = 0;  // width, if nothing is wrapped
    size_t least = 0;    // narrower than this it is hard to read
    bool right = false;  // aligned
  };
  std::vector<TextColumn> MeasureText() const;
  static std::vector<size_t> FitWidths(const std::vector<TextColumn>& columns, size_t width);
  // Appends some columns beside each other, each with its width.
  void AppendText(const std::vector<TextColumn>& columns, const std::vector<size_t>& widths, bool colour,
                  std::string* text) const;

  std::vector<Column> columns_;
  size_t keys_;
  std::vector<std::vector<Cell>> rows_;
};

// Returns a number as printf writes it, in up to 63 characters.
std::string Format(const char* format, double value);

}  // namespace saltus
