#include "output/text_layout.h"

#include <glog/logging.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <optional>

namespace saltus {
namespace {

bool StartsCharacter(char c) { return (static_cast<unsigned char>(c) & 0xc0) != 0x80; }

// Bytes of the first `columns` characters.
size_t PrefixOf(std::string_view text, size_t columns) {
  size_t seen = 0;
  for (size_t i = 0; i < text.size(); ++i) {
    if (StartsCharacter(text[i]) && ++seen > columns) return i;
  }
  return text.size();
}

std::optional<size_t> ColumnsFromEnvironment() {
  const char* value = std::getenv("COLUMNS");
  if (value == nullptr) return std::nullopt;
  size_t columns = 0;
  const char* end = value + std::strlen(value);
  const auto [last, error] = std::from_chars(value, end, columns);
  if (error != std::errc() || last != end || columns == 0) return std::nullopt;
  return columns;
}

}  // namespace

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

size_t DisplayWidth(std::string_view text) {
  return static_cast<size_t>(std::count_if(text.begin(), text.end(), StartsCharacter));
}

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
  // Too narrow for an indent is too narrow.
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
