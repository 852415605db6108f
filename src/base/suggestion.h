// Suggestions for mistyped names in messages.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace saltus {

// "; did you mean ...?" if one of `words` is close to `word`, else "". Very long words are close to none.
std::string Suggestion(std::string_view word, const std::vector<std::string>& words);

}  // namespace saltus
