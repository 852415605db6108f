// Tables in pages too narrow for them: every row becomes a card of its own, labels above values.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace saltus::internal {

// The class of a <table> whose columns need so many characters each: it says below which width of its surroundings rows
// are cards. Cells are to have their column's header as data-label, and those that name a row the class "key".
std::string CardsClass(const std::vector<size_t>& characters);

// The style of all these classes. What surrounds a table is an element of the class "scroll".
std::string CardsStyle();

}  // namespace saltus::internal
