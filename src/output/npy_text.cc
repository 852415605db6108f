#include "output/npy_text.h"

#include <algorithm>
#include <cstring>

namespace saltus::internal {
namespace {

constexpr char32_t kReplacement = 0xfffd;
constexpr char32_t kLargestCharacter = 0x10ffff;

// Reads one character at `at` and moves on.
char32_t TakeCharacter(const std::string& text, size_t* at) {
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned first = byte((*at)++);
  if (first < 0x80) return first;
  const int more = first >= 0xf0 ? 3 : first >= 0xe0 ? 2 : first >= 0xc0 ? 1 : 0;
  if (more == 0 || first > 0xf4) return kReplacement;
  char32_t character = first & (0x3fu >> more);
  for (int i = 0; i < more; ++i) {
    if (*at == text.size() || (byte(*at) & 0xc0) != 0x80) return kReplacement;
    character = character << 6 | (byte((*at)++) & 0x3f);
  }
  return std::min(character, kLargestCharacter);
}

void AppendCharacter(char32_t c, std::string* text) {
  if (c < 0x80) {
    *text += static_cast<char>(c);
    return;
  }
  const int more = c < 0x800 ? 1 : c < 0x10000 ? 2 : 3;
  *text += static_cast<char>((0xff00u >> (more + 1) & 0xff) | c >> (6 * more));
  for (int i = more - 1; i >= 0; --i) *text += static_cast<char>(0x80 | (c >> (6 * i) & 0x3f));
}

}  // namespace

NpyText EncodeNpyText(const std::vector<std::string>& texts) {
  std::vector<std::u32string> wide;
  size_t width = 1;
  for (const std::string& text : texts) {
    wide.emplace_back();
    for (size_t at = 0; at < text.size();) wide.back() += TakeCharacter(text, &at);
    width = std::max(width, wide.back().size());
  }
  NpyText result{static_cast<int>(width), {}};
  for (std::u32string& text : wide) {
    text.resize(width, U'\0');
    result.bytes.append(reinterpret_cast<const char*>(text.data()), text.size() * sizeof(char32_t));
  }
  return result;
}

std::optional<std::vector<std::string>> DecodeNpyText(const NpyText& text) {
  const size_t width = static_cast<size_t>(text.width);
  const size_t entry = width * sizeof(char32_t);
  if (text.bytes.empty()) return std::vector<std::string>();  // whatever the width, for which there may be no memory
  if (text.bytes.size() % entry != 0) return std::nullopt;
  std::vector<std::string> texts(text.bytes.size() / entry);
  std::u32string wide(width, U'\0');
  for (size_t i = 0; i < texts.size(); ++i) {
    std::memcpy(wide.data(), text.bytes.data() + i * entry, entry);
    for (const char32_t c : wide) {
      if (c > kLargestCharacter) return std::nullopt;
      if (c == U'\0') break;
      AppendCharacter(c, &texts[i]);
    }
  }
  return texts;
}

}  // namespace saltus::internal
