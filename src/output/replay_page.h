// The script and the style of a page with replays: the files of src/output/page, put in at build time.
#pragma once

#include <string_view>

namespace saltus::internal {

std::string_view ReplayStyle();
std::string_view ReplayScript();

}  // namespace saltus::internal
