#include "prt/clip/internal/journal.h"

#include <cstring>

#include "core/io/hash.h"

namespace penumbra::prt {

namespace {

constexpr char kJournalMagic[8] = {'P', 'N', 'B', 'J', 'R', 'N', 'L', '1'};
struct JournalHead {
  char magic[8];
  std::uint64_t bake, values;
  std::uint32_t frames, unused;
};
struct RecordHead {
  std::uint32_t frame, unused;
  std::uint64_t rays, seen;
  double seconds, error_variance, mean;
  std::uint64_t sum;  // fingerprint of all of the above and of the values
};

std::uint64_t sum_of(RecordHead head, std::span<const std::uint16_t> values) {
  head.sum = 0;
  return Fnv1a().add(head).add(values.data(), values.size_bytes()).value();
}

// visit(record) for every whole record; how many bytes they and the head take.
template <class Visit>
Result<std::uintmax_t> scan(const std::filesystem::path& path, const JournalKey& key,
                            const Visit& visit) {
  std::ifstream in(path, std::ios::binary);
  if (!in) return fail(ErrorCode::kNotFound, path.string(), "is missing: bake this shard first");
  JournalHead head{};
  in.read(reinterpret_cast<char*>(&head), sizeof head);
  if (!in || std::memcmp(head.magic, kJournalMagic, sizeof kJournalMagic) != 0)
    return fail(ErrorCode::kUnreadable, path.string(), "is not a journal of a bake: remove it");
  if (JournalKey{head.bake, head.frames, head.values} != key)
    return fail(ErrorCode::kInvalid, path.string(),
                "is the journal of another bake, with another asset, clip or setting: remove it, "
                "or choose another output");
  std::uintmax_t good = sizeof head;
  FrameRecord record;
  record.values.resize(static_cast<std::size_t>(key.values));
  const auto bytes = static_cast<std::streamsize>(record.values.size() * sizeof(std::uint16_t));
  RecordHead r{};
  while (in.read(reinterpret_cast<char*>(&r), sizeof r) &&
         in.read(reinterpret_cast<char*>(record.values.data()), bytes)) {
    if (r.sum != sum_of(r, record.values) || r.frame >= key.frames) break;
    record.frame = r.frame;
    record.rays = r.rays;
    record.seconds = r.seconds;
    record.error_variance = r.error_variance;
    record.mean = r.mean;
    record.seen = r.seen;
    visit(record);
    good += sizeof r + static_cast<std::uintmax_t>(bytes);
  }
  return good;
}

}  // namespace

Result<Journal> Journal::open(const std::filesystem::path& path, const JournalKey& key) {
  Journal out;
  out.path_ = path;
  std::error_code error;
  // One without a whole frame holds nothing that could be lost.
  if (!std::filesystem::exists(path, error) ||
      std::filesystem::file_size(path, error) <= sizeof(JournalHead)) {
    out.out_.open(path, std::ios::binary | std::ios::trunc);
    JournalHead head{};
    std::memcpy(head.magic, kJournalMagic, sizeof kJournalMagic);
    head.bake = key.bake;
    head.frames = key.frames;
    head.values = key.values;
    out.out_.write(reinterpret_cast<const char*>(&head), sizeof head);
  } else {
    PENUMBRA_ASSIGN(good,
                    scan(path, key, [&](const FrameRecord& r) { out.frames_.push_back(r.frame); }));
    std::filesystem::resize_file(path, good, error);
    out.out_.open(path, std::ios::binary | std::ios::app);
  }
  out.out_.flush();
  if (error || !out.out_)
    return fail(ErrorCode::kUnwritable, path.string(),
                "cannot be written to, and baked frames are kept there");
  return out;
}

Result<void> Journal::add(const FrameRecord& record) {
  RecordHead r{record.frame, 0, record.rays, record.seen, record.seconds, record.error_variance,
               record.mean,  0};
  r.sum = sum_of(r, record.values);
  out_.write(reinterpret_cast<const char*>(&r), sizeof r);
  out_.write(reinterpret_cast<const char*>(record.values.data()),
             static_cast<std::streamsize>(record.values.size() * sizeof(std::uint16_t)));
  out_.flush();
  if (!out_)
    return fail(ErrorCode::kUnwritable, path_.string(),
                "cannot be written to; the frames before this one are kept");
  frames_.push_back(record.frame);
  return {};
}

Result<std::vector<std::uint32_t>> frames_of_journal(const std::filesystem::path& path,
                                                     const JournalKey& key) {
  std::vector<std::uint32_t> out;
  PENUMBRA_TRY(scan(path, key, [&](const FrameRecord& r) { out.push_back(r.frame); }));
  return out;
}

Result<std::vector<FrameRecord>> read_journal(const std::filesystem::path& path,
                                              const JournalKey& key) {
  std::vector<FrameRecord> out;
  PENUMBRA_TRY(scan(path, key, [&](const FrameRecord& r) { out.push_back(r); }));
  return out;
}

}  // namespace penumbra::prt
