// SPDX-License-Identifier: Apache-2.0
#include "registration/calibration_images.hpp"

#include <algorithm>
#include <charconv>
#include <exception>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <thread>

#include <fmt/format.h>

#include "registration/chessboard.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

namespace fs = std::filesystem;

std::optional<double> zoom_of(const std::string& name) {
  constexpr std::string_view kPrefix = "zoom_";
  if (!name.starts_with(kPrefix)) return std::nullopt;
  double zoom = 0;
  const char* end = name.data() + name.size();
  const auto [stop, error] = std::from_chars(name.data() + kPrefix.size(), end, zoom);
  if (error != std::errc() || stop != end || !(zoom > 0 && zoom < 1e3)) return std::nullopt;
  return zoom;
}

bool is_image(const fs::path& path) {
  static const std::set<std::string> extensions = {".png",  ".tif", ".tiff", ".jpg",
                                                   ".jpeg", ".bmp", ".pgm"};
  return extensions.contains(path.extension().string());
}

ZoomImages images_of(double zoom, const fs::path& folder) {
  std::map<std::string, std::string> left, right;  // by what follows the side in the name
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (!is_image(entry.path())) continue;
    if (name.starts_with("left")) left[name.substr(4)] = entry.path().string();
    if (name.starts_with("right")) right[name.substr(5)] = entry.path().string();
  }
  ZoomImages images{zoom, {}};
  for (const auto& [key, path] : left) {
    if (!right.contains(key)) throw RefusedError(path + ": has no right image beside it");
    images.pairs.push_back({path, right[key]});
  }
  for (const auto& [key, path] : right)
    if (!left.contains(key)) throw RefusedError(path + ": has no left image beside it");
  return images;
}

std::string missing_text(const std::string& path, const BoardPattern& board, cv::Size seen) {
  if (seen.area() == 0) return path + ": shows no chessboard";
  return fmt::format("{}: shows {}x{} corners, not {}x{}", path, std::max(seen.width, seen.height),
                     std::min(seen.width, seen.height), board.columns, board.rows);
}

/// The work, shared by the threads.
class Search {
 public:
  Search(const std::vector<ZoomImages>& images, const BoardPattern& board,
         const std::function<cv::Mat(const std::string&)>& read,
         const std::function<void(int, int)>& progress)
      : images_(images), board_(board), read_(read), progress_(progress) {
    for (std::size_t z = 0; z < images.size(); ++z)
      for (std::size_t i = 0; i < images[z].pairs.size(); ++i) jobs_.push_back({z, i, {}, {}});
  }

  void work() {
    while (Job* job = next()) try {
        const ImagePair& pair = images_[job->zoom].pairs[job->pair];
        if (auto left = view(pair.left, *job))
          if (auto right = view(pair.right, *job)) {
            match_corner_order(board_, *left, *right);
            job->found = {pair.left, *left, *right};
          }
        const std::lock_guard lock(mutex_);
        ++done_;
        if (progress_) progress_(done_, static_cast<int>(jobs_.size()));
      } catch (...) {
        const std::lock_guard lock(mutex_);
        if (!failure_) failure_ = std::current_exception();
        next_ = jobs_.size();
      }
  }

  BoardSearch result() {
    if (failure_) std::rethrow_exception(failure_);
    BoardSearch search;
    search.image = size_;
    for (const ZoomImages& zoom : images_) search.views.push_back({zoom.zoom, {}});
    for (const Job& job : jobs_) {
      if (job.reason.empty())
        search.views[job.zoom].pairs.push_back(job.found);
      else
        search.skipped.push_back({images_[job.zoom].pairs[job.pair].left, job.reason});
    }
    if (search.skipped.size() == jobs_.size())
      throw RefusedError(fmt::format("no pair shows the whole {}x{} board; {}", board_.columns,
                                     board_.rows,
                                     jobs_.empty() ? "there are no pairs" : jobs_[0].reason));
    return search;
  }

 private:
  struct Job {
    std::size_t zoom, pair;
    BoardPair found;
    std::string reason;  // why not
  };

  Job* next() {
    const std::lock_guard lock(mutex_);
    return next_ < jobs_.size() ? &jobs_[next_++] : nullptr;
  }

  std::optional<std::vector<cv::Point2d>> view(const std::string& path, Job& job) {
    cv::Mat grey;
    {
      const std::lock_guard lock(mutex_);
      grey = read_(path);
      if (size_.area() == 0) size_ = grey.size();
      if (grey.size() != size_)
        throw RefusedError(fmt::format("{}: is {}x{} px, must be {}x{} px as the images before it",
                                       path, grey.cols, grey.rows, size_.width, size_.height));
    }
    ChessboardView found = find_chessboard(grey, board_);
    if (!found.corners.empty()) return found.corners;
    job.reason = missing_text(path, board_, found.seen);
    return std::nullopt;
  }

  const std::vector<ZoomImages>& images_;
  BoardPattern board_;
  const std::function<cv::Mat(const std::string&)>& read_;
  const std::function<void(int, int)>& progress_;
  std::mutex mutex_;
  std::vector<Job> jobs_;
  std::size_t next_ = 0;
  int done_ = 0;
  cv::Size size_{0, 0};
  std::exception_ptr failure_;
};

}  // namespace

std::vector<ZoomImages> list_calibration_images(const std::string& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) throw InputError(folder + ": is not a folder");
  std::vector<ZoomImages> zooms;
  for (const auto& entry : fs::directory_iterator(folder))
    if (const auto zoom = zoom_of(entry.path().filename().string()); zoom && entry.is_directory())
      zooms.push_back(images_of(*zoom, entry.path()));
  if (zooms.empty()) throw InputError(folder + ": holds no folder zoom_<number>");
  std::sort(zooms.begin(), zooms.end(),
            [](const ZoomImages& a, const ZoomImages& b) { return a.zoom < b.zoom; });
  for (std::size_t z = 1; z < zooms.size(); ++z)
    if (zooms[z].zoom - zooms[z - 1].zoom < 1e-6)
      throw InputError(fmt::format("{}: holds zoom {:g} twice", folder, zooms[z].zoom));
  return zooms;
}

BoardSearch find_boards(const std::vector<ZoomImages>& images, const BoardPattern& board,
                        int threads, const std::function<cv::Mat(const std::string&)>& read,
                        const std::function<void(int, int)>& progress) {
  Search search(images, board, read, progress);
  {
    std::vector<std::jthread> workers;
    for (int i = 1; i < threads; ++i) workers.emplace_back([&search] { search.work(); });
    search.work();
  }
  return search.result();
}

}  // namespace holdfast::registration
