// The known word that somebody may have meant.
// threads: reentrant
#pragma once

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// Fewest letters to add, leave out, change or swap with their neighbour.
/// source: Damerau 1964, Levenshtein 1966 (optimal string alignment)
inline std::size_t spelling_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> before(b.size() + 1), last(b.size() + 1), now(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) last[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    now[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      now[j] = std::min({last[j] + 1, now[j - 1] + 1, last[j - 1] + (a[i - 1] != b[j - 1])});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        now[j] = std::min(now[j], before[j - 2] + 1);
    }
    before.swap(last);
    last.swap(now);
  }
  return last[b.size()];
}

/// The nearest of `known` that differs by at most a third of the word's letters, and by one at
/// least.
template <class Words>
std::optional<std::string> nearest_word(std::string_view word, const Words& known) {
  std::optional<std::string> best;
  std::size_t smallest = std::string_view::npos;
  for (const auto& k : known) {
    const std::size_t most =
        std::max<std::size_t>(1, std::max(word.size(), std::string_view(k).size()) / 3);
    if (const std::size_t d = spelling_distance(word, k); d <= most && d < smallest)
      smallest = d, best = std::string(k);
  }
  return best;
}

}  // namespace penumbra
#pragma GCC visibility pop
