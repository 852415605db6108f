#include "base/table.h"

#include <glog/logging.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cstdlib>

#include "base/csv.h"
#include "base/number_text.h"

namespace saltus {
namespace {

constexpr size_t kLongText = 40;  // characters from which a cell is a sentence rather than a word

std::string_view AnsiColour(Tone tone) {
  static constexpr std::string_view kCodes[] = {"", "\033[32m", "\033[33m", "\033[31m", "\033[2m"};
  return kCodes[static_cast<int>(tone)];
}

std::string Pad(const std::string& text, size_t width, bool right) {
  const std::string space(width - std::min(width, DisplayWidth(text)), ' ');
  return right ? space + text : text + space;
}

// Returns the columns of the widest line or word.
size_t Widest(std::string_view text, std::string_view separators) {
  size_t widest = 0;
  for (size_t begin = 0; begin <= text.size();) {
    const size_t end = std::min(text.find_first_of(separators, begin), text.size());
    widest = std::max(widest, DisplayWidth(text.substr(begin, end - begin)));
    begin = end + 1;
  }
  return widest;
}

constexpr size_t kGap = 2;        // columns between those of a table
constexpr size_t kPhrase = 12;    // columns to which texts of a few words may be wrapped,
constexpr size_t kName = 20;      // keys,
constexpr size_t kSentence = 24;  // and long texts
constexpr size_t kSqueezed = 4;   // the narrowest that a column of text gets where there is no room

size_t WidthOf(const std::vector<size_t>& widths) {
  size_t sum = 0;
  for (const size_t width : widths) sum += width + kGap;
  return widths.empty() ? 0 : sum - kGap;
}

bool IsAlphanumeric(std::string_view text, size_t i) {
  return i < text.size() && std::isalnum(static_cast<unsigned char>(text[i])) != 0;
}

std::string EscapeMarkdown(std::string_view text) {
  std::string escaped;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    // An underscore within a word is no Markdown markup, and model names have many of them.
    const bool within_word = c == '_' && i > 0 && IsAlphanumeric(text, i - 1) && IsAlphanumeric(text, i + 1);
    if (c == '\n') {
      escaped += "<br>";
    } else {
      if (std::string_view("\\|*_`<[").find(c) != std::string_view::npos && !within_word) escaped += '\\';
      escaped += c;
    }
  }
  return escaped;
}

std::string QuoteCsv(const std::string& field) {
  if (field.find_first_of(",\"\r\n") == std::string::npos) return field;
  std::string quoted = "\"";
  for (const char c : field) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + '"';
}

bool StartsCharacter(char c) { return (static_cast<unsigned char>(c) & 0xc0) != 0x80; }

std::optional<size_t> ColumnsFromEnvironment() {
  const char* value = std::getenv("COLUMNS");
  if (value == nullptr) return std::nullopt;
  const std::optional<size_t> columns = FromText<size_t>(value);
  return columns.value_or(0) > 0 ? columns : std::nullopt;
}

}  // namespace

std::string CsvLine(const std::vector<std::string>& fields) {
  // A record of one empty field is quoted, because readers skip empty lines.
  if (fields.size() == 1 && fields[0].empty()) return "\"\"\n";
  std::string line;
  for (const std::string& field : fields) line += (&field == &fields[0] ? "" : ",") + QuoteCsv(field);
  return line + '\n';
}

std::string_view ToneName(Tone tone) {
  static constexpr std::string_view kNames[] = {"", "good", "warning", "bad", "muted"};
  return kNames[static_cast<int>(tone)];
}

std::string Cell::Display(int significant_digits) const {
  const double* number = std::get_if<double>(&value_);
  if (number == nullptr) return Exact();
  std::array<char, 64> buffer;
  const auto [end, error] = std::to_chars(
      buffer.data(), buffer.data() + buffer.size(), *number, std::chars_format::general, significant_digits);
  CHECK(error == std::errc()) << significant_digits << " digits";
  return std::string(buffer.data(), end);
}

std::string Cell::Exact() const {
  if (const auto* text = std::get_if<std::string>(&value_)) return *text;
  if (const auto* whole = std::get_if<int64_t>(&value_)) return std::to_string(*whole);
  const double* number = std::get_if<double>(&value_);
  return number == nullptr ? "" : ToText(*number);
}

std::vector<Column> ColumnsOf(std::string_view text) {
  std::vector<Column> columns;
  while (!text.empty()) {
    const size_t end = std::min(text.find("; "), text.size());
    Column& column = columns.emplace_back(Column{std::string(text.substr(0, end))});
    text.remove_prefix(std::min(end + 2, text.size()));
    const size_t colon = column.header.rfind(':');
    if (colon == std::string::npos) continue;
    column.significant_digits = std::stoi(column.header.substr(colon + 1));
    column.header.resize(colon);
  }
  return columns;
}

Table::Table(std::vector<Column> columns, size_t keys) : columns_(std::move(columns)), keys_(keys) {
  CHECK_GE(keys, 1);
  CHECK_LE(keys, columns_.size());
}

void Table::AddRow(std::vector<Cell> row) {
  CHECK_EQ(row.size(), columns_.size());
  rows_.push_back(std::move(row));
}

bool Table::IsNumeric(size_t column) const {
  return std::ranges::none_of(rows_, [&](const auto& row) { return row[column].IsText(); });
}

std::string Table::Display(size_t row, size_t column) const {
  const Cell& cell = rows_[row][column];
  return cell.Display(cell.significant_digits().value_or(columns_[column].significant_digits));
}

std::string Table::ToMarkdown() const {
  std::vector<std::string> lines(rows_.size() + 2, "|");
  for (size_t j = 0; j < columns_.size(); ++j) {
    std::vector<std::string> texts = {EscapeMarkdown(columns_[j].header)};
    for (size_t i = 0; i < rows_.size(); ++i) texts.push_back(EscapeMarkdown(Display(i, j)));
    size_t width = 3;
    for (const std::string& text : texts) width = std::max(width, DisplayWidth(text));
    const bool right = IsNumeric(j);
    const std::string rule = std::string(width + 1, '-') + (right ? ":" : "-");
    texts.insert(texts.begin() + 1, rule);
    for (size_t i = 0; i < texts.size(); ++i) {
      lines[i] += i == 1 ? rule + "|" : " " + Pad(texts[i], width, right) + " |";
    }
  }
  std::string text;
  for (const std::string& line : lines) text += line + '\n';
  return text;
}

std::string Table::ToCsv() const {
  std::vector<std::string> fields;
  for (const Column& column : columns_) fields.push_back(column.header);
  std::string text = CsvLine(fields);
  for (const auto& row : rows_) {
    fields.clear();
    for (const Cell& cell : row) fields.push_back(cell.Exact());
    text += CsvLine(fields);
  }
  return text;
}

std::vector<size_t> Table::ColumnsWithContent() const {
  std::vector<size_t> shown;
  for (size_t j = 0; j < columns_.size(); ++j) {
    const bool empty = std::ranges::all_of(rows_, [&](const auto& row) { return row[j].Exact().empty(); });
    if (j < keys_ || !empty || rows_.empty()) shown.push_back(j);
  }
  return shown;
}

std::vector<Table::TextColumn> Table::MeasureText() const {
  std::vector<TextColumn> columns;
  for (const size_t j : ColumnsWithContent()) {
    TextColumn column{.index = j, .right = IsNumeric(j)};
    const std::string& header = columns_[j].header;
    column.natural = std::max<size_t>(Widest(header, "\n"), 1);
    column.least = std::max<size_t>(Widest(header, " \n"), 1);
    for (size_t i = 0; i < rows_.size(); ++i) {
      const std::string text = Display(i, j);
      const size_t natural = Widest(text, "\n");
      const size_t readable = natural > kLongText ? kSentence : std::min(natural, j < keys_ ? kName : kPhrase);
      column.natural = std::max(column.natural, natural);
      column.least = std::max({column.least, readable, column.right ? natural : Widest(text, " \n")});
    }
    columns.push_back(column);
  }
  return columns;
}

bool Table::FitsOneLine(size_t width) const {
  std::vector<size_t> widths;
  for (const TextColumn& column : MeasureText()) widths.push_back(column.natural);
  return WidthOf(widths) <= width;
}

std::vector<size_t> Table::FitWidths(const std::vector<TextColumn>& columns, size_t width) {
  std::vector<size_t> widths;
  for (const TextColumn& column : columns) widths.push_back(column.least);
  // The remaining columns go to the text that is wrapped most.
  for (size_t used = WidthOf(widths); used < width; ++used) {
    size_t most = 0;
    for (size_t j = 1; j < columns.size(); ++j) {
      if (columns[j].natural * widths[most] > columns[most].natural * widths[j]) most = j;
    }
    if (widths[most] >= columns[most].natural) break;
    ++widths[most];
  }
  // Missing columns are taken from the widest text, whose words then break.
  while (WidthOf(widths) > width) {
    size_t widest = columns.size();
    for (size_t j = 0; j < columns.size(); ++j) {
      if (columns[j].right || widths[j] <= kSqueezed) continue;
      if (widest == columns.size() || widths[j] > widths[widest]) widest = j;
    }
    if (widest == columns.size()) break;
    --widths[widest];
  }
  return widths;
}

std::string Table::ToText(const TextLayout& layout) const {
  const std::vector<TextColumn> columns = MeasureText();
  const auto keys_end = columns.begin() + static_cast<std::ptrdiff_t>(keys_);
  std::string text;
  for (auto next = keys_end; text.empty() || next != columns.end();) {
    std::vector<TextColumn> block(columns.begin(), keys_end);
    size_t width = 0;
    for (const TextColumn& key : block) width += key.least + kGap;
    for (; next != columns.end(); ++next) {
      if (block.size() > keys_ && width + next->least > layout.width) break;
      width += next->least + kGap;
      block.push_back(*next);
    }
    if (!text.empty()) text += '\n';
    AppendText(block, FitWidths(block, layout.width), layout.colour, &text);
  }
  return text;
}

void Table::AppendText(const std::vector<TextColumn>& columns, const std::vector<size_t>& widths, bool colour,
                       std::string* text) const {
  // Appends one row, on as many lines as it takes.
  const auto append = [&](const auto& text_of, const auto& tone_of) {
    std::vector<std::vector<std::string>> cells;
    size_t height = 0;
    for (size_t j = 0; j < columns.size(); ++j) {
      cells.push_back(WrapText(text_of(columns[j].index), widths[j]));
      height = std::max(height, cells.back().size());
    }
    for (size_t k = 0; k < height; ++k) {
      std::string line;
      size_t blank = 0;  // columns that are not needed unless something follows
      for (size_t j = 0; j < columns.size(); ++j) {
        const std::string part = k < cells[j].size() ? cells[j][k] : "";
        const std::string padded = Pad(part, widths[j], columns[j].right);
        const size_t end = padded.find_last_not_of(' ') + 1;
        if (end > 0) {
          const std::string_view start = colour ? AnsiColour(tone_of(columns[j].index)) : "";
          line +=
              std::string(blank, ' ') + std::string(start) + padded.substr(0, end) + (start.empty() ? "" : "\033[0m");
          blank = 0;
        }
        blank += padded.size() - end + kGap;
      }
      *text += line + '\n';
    }
  };
  const auto plain = [](size_t) { return Tone::kPlain; };
  append([&](size_t j) { return columns_[j].header; }, plain);
  std::vector<std::string> rules(columns_.size());
  for (size_t j = 0; j < columns.size(); ++j) rules[columns[j].index].assign(widths[j], '-');
  append([&](size_t j) { return rules[j]; }, plain);
  for (size_t i = 0; i < rows_.size(); ++i) {
    append([&](size_t j) { return Display(i, j); }, [&](size_t j) { return rows_[i][j].tone(); });
  }
}

Table Table::Transposed(std::string corner, size_t keys) const {
  std::vector<Column> columns = {{std::move(corner)}};
  for (size_t i = 0; i < rows_.size(); ++i) columns.push_back({Display(i, 0)});
  Table table(columns, keys);
  for (size_t j = 1; j < columns_.size(); ++j) {
    std::vector<Cell> row = {columns_[j].header};
    for (const auto& cells : rows_) {
      row.push_back(cells[j]);
      row.back().WithDigits(cells[j].significant_digits().value_or(columns_[j].significant_digits));
    }
    table.AddRow(std::move(row));
  }
  return table;
}

std::string Format(const char* format, double value) {
  char buffer[64];
  std::snprintf(buffer, sizeof(buffer), format, value);
  return buffer;
}

TextLayout LayoutOfStandardOutput() {
  TextLayout layout;
  layout.width = ColumnsFromEnvironment().value_or(TerminalColumns(stdout, layout.width));
  layout.colour = isatty(STDOUT_FILENO) != 0 && std::getenv("NO_COLOR") == nullptr;
  return layout;
}

size_t TerminalColumns(std::FILE* sink, size_t if_none) {
  winsize size{};
  const bool known = ioctl(fileno(sink), TIOCGWINSZ, &size) == 0 && size.ws_col > 0;
  return known ? size.ws_col : if_none;
}

std::string Joined(const std::vector<std::string>& words, std::string_view separator, std::string_view quote) {
  std::string text;
  for (const std::string& word : words) {
    if (&word != &words.front()) text += separator;
    text.append(quote).append(word).append(quote);
  }
  return text;
}

std::string JoinedNames(const std::vector<std::string>& names) {
  return names.empty() ? "none" : Joined(names, ", ", "`");
}

size_t PrefixOf(std::string_view text, size_t columns) {
  size_t seen = 0;
  for (size_t i = 0; i < text.size(); ++i) {
    if (StartsCharacter(text[i]) && ++seen > columns) return i;
  }
  return text.size();
}

size_t DisplayWidth(std::string_view text) { return static_cast<size_t>(std::ranges::count_if(text, StartsCharacter)); }

std::vector<std::string> WrapText(std::string_view text, size_t width) {
  CHECK_GT(width, 0);
  std::vector<std::string> lines(1);
  size_t used = 0;   // columns of the last line
  size_t space = 0;  // before the next word
  const auto break_line = [&] {
    lines.emplace_back();
    used = space = 0;
  };
  while (!text.empty()) {
    if (text[0] == '\n' || text[0] == ' ') {
      if (text[0] == '\n') {
        break_line();
      } else {
        ++space;
      }
      text.remove_prefix(1);
      continue;
    }
    std::string_view word = text.substr(0, text.find_first_of(" \n"));
    text.remove_prefix(word.size());
    if (used > 0 && used + space + DisplayWidth(word) > width) break_line();
    if (space < width) {
      lines.back().append(space, ' ');
      used += space;
    }
    space = 0;
    for (size_t room = width - used; DisplayWidth(word) > room; room = width) {
      const size_t bytes = PrefixOf(word, room);
      lines.back() += word.substr(0, bytes);
      word.remove_prefix(bytes);
      break_line();
    }
    lines.back() += word;
    used += DisplayWidth(word);
  }
  return lines;
}

std::string Paragraph(std::string_view text, size_t width, size_t indent, std::string_view label) {
  // In a width of two indents or less the indent is dropped.
  const size_t room = width > 2 * indent ? width - indent : width;
  const std::string margin(width - room, ' ');
  std::string paragraph(label);
  if (label.size() >= margin.size() && !label.empty()) {
    paragraph += '\n' + margin;
  } else {
    paragraph += margin.substr(label.size());
  }
  std::string_view separator = "";
  for (const std::string& line : WrapText(text, room)) {
    paragraph += std::string(separator) + (separator.empty() ? "" : margin) + line;
    separator = "\n";
  }
  return paragraph + '\n';
}

}  // namespace saltus
