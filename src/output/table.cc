#include "output/table.h"

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cstdio>
#include <functional>

#include "io/file.h"

namespace saltus {
namespace {

constexpr size_t kLongText = 40;  // characters from which a cell is a sentence rather than a word

std::string_view AnsiColour(Tone tone) {
  switch (tone) {
    case Tone::kPlain:
      return "";
    case Tone::kGood:
      return "\033[32m";
    case Tone::kWarning:
      return "\033[33m";
    case Tone::kBad:
      return "\033[31m";
    case Tone::kMuted:
      return "\033[2m";
  }
  return "";
}

// Columns that UTF-8 text takes on a terminal, were every code point one column wide.
size_t Width(std::string_view text) {
  return static_cast<size_t>(
      std::count_if(text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xc0) != 0x80; }));
}

std::string Pad(const std::string& text, size_t width, bool right) {
  const std::string space(width - std::min(width, Width(text)), ' ');
  return right ? space + text : text + space;
}

bool IsAlphanumeric(std::string_view text, size_t i) {
  return i < text.size() && std::isalnum(static_cast<unsigned char>(text[i])) != 0;
}

std::string EscapeMarkdown(std::string_view text) {
  std::string escaped;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    // An underscore within a word is no markup, and model names are full of them.
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

std::string CsvLine(const std::vector<std::string>& fields) {
  // A line of one empty field would be an empty line, which readers skip.
  if (fields.size() == 1 && fields[0].empty()) return "\"\"\n";
  std::string line;
  for (const std::string& field : fields) line += (&field == &fields[0] ? "" : ",") + QuoteCsv(field);
  return line + '\n';
}

}  // namespace

std::string_view ToneName(Tone tone) {
  switch (tone) {
    case Tone::kPlain:
      return "";
    case Tone::kGood:
      return "good";
    case Tone::kWarning:
      return "warning";
    case Tone::kBad:
      return "bad";
    case Tone::kMuted:
      return "muted";
  }
  return "";
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
  if (number == nullptr) return "";
  std::array<char, 64> buffer;
  return std::string(buffer.data(), std::to_chars(buffer.data(), buffer.data() + buffer.size(), *number).ptr);
}

void Table::AddRow(std::vector<Cell> row) {
  CHECK_EQ(row.size(), columns_.size());
  rows_.push_back(std::move(row));
}

bool Table::IsNumeric(size_t column) const {
  return std::none_of(rows_.begin(), rows_.end(), [&](const auto& row) { return row[column].IsText(); });
}

std::string Table::Display(size_t row, size_t column) const {
  return rows_[row][column].Display(columns_[column].significant_digits);
}

std::string Table::ToMarkdown() const {
  std::vector<std::string> lines(rows_.size() + 2, "|");
  for (size_t j = 0; j < columns_.size(); ++j) {
    std::vector<std::string> texts = {EscapeMarkdown(columns_[j].header)};
    for (size_t i = 0; i < rows_.size(); ++i) texts.push_back(EscapeMarkdown(Display(i, j)));
    size_t width = 3;
    for (const std::string& text : texts) width = std::max(width, Width(text));
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

std::string Table::ToHtml() const {
  std::vector<std::string> alignment;
  for (size_t j = 0; j < columns_.size(); ++j) alignment.emplace_back(IsNumeric(j) ? "number" : "");
  const auto open = [](const std::string& tag, const std::string& classes) {
    return "<" + tag + (classes.empty() ? "" : " class=\"" + classes + "\"") + ">";
  };
  std::string html = "<table>\n<thead><tr>";
  for (size_t j = 0; j < columns_.size(); ++j) {
    html += open("th scope=\"col\"", alignment[j]) + EscapeHtml(columns_[j].header) + "</th>";
  }
  html += "</tr></thead>\n<tbody>\n";
  for (size_t i = 0; i < rows_.size(); ++i) {
    html += "<tr>";
    for (size_t j = 0; j < columns_.size(); ++j) {
      const std::string text = Display(i, j);
      std::string classes = alignment[j];
      const std::string_view length = Width(text) > kLongText ? "long" : "";
      for (const std::string_view name : {ToneName(rows_[i][j].tone()), length}) {
        if (!name.empty()) classes += (classes.empty() ? "" : " ") + std::string(name);
      }
      html += open("td", classes) + EscapeHtml(text) + "</td>";
    }
    html += "</tr>\n";
  }
  return html + "</tbody>\n</table>\n";
}

std::string Table::ToText(bool colour) const {
  std::vector<std::string> lines(rows_.size() + 2);
  for (size_t j = 0; j < columns_.size(); ++j) {
    size_t width = Width(columns_[j].header);
    for (size_t i = 0; i < rows_.size(); ++i) width = std::max(width, Width(Display(i, j)));
    const bool right = IsNumeric(j);
    const std::string gap = j == 0 ? "" : "  ";
    lines[0] += gap + Pad(columns_[j].header, width, right);
    lines[1] += gap + std::string(width, '-');
    for (size_t i = 0; i < rows_.size(); ++i) {
      const std::string_view start = colour ? AnsiColour(rows_[i][j].tone()) : "";
      const std::string padded = Pad(Display(i, j), width, right);
      lines[i + 2] += gap + std::string(start) + padded + (start.empty() ? "" : "\033[0m");
    }
  }
  std::string text;
  for (std::string& line : lines) {
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + '\n';
  }
  return text;
}

std::string EscapeHtml(std::string_view text) {
  std::string escaped;
  for (const char c : text) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      case '\'':
        escaped += "&#39;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string Format(const char* format, double value) {
  char buffer[64];
  std::snprintf(buffer, sizeof(buffer), format, value);
  return buffer;
}

}  // namespace saltus
