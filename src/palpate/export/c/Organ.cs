// The model @NAME@ in C#: for Unity, put the shared library and this file into Assets/Plugins, and
// @NAME@.palpate into Assets/StreamingAssets. Lengths in m, forces in N; axes and signs as in palpate (right-handed).
using System;
using System.IO;
using System.Runtime.InteropServices;
using System.Text;

namespace Palpate
{
    public sealed class Organ : IDisposable
    {
        const string Library = "@NAME@";
        [DllImport(Library)] static extern int @NAME@_step(IntPtr memory);
        [DllImport(Library)] static extern int @NAME@_reset(IntPtr memory);
        [DllImport(Library)] static extern int @NAME@_set_tool(IntPtr memory);
        [DllImport(Library)] static extern int @NAME@_vertices(IntPtr memory);
        [DllImport(Library)] static extern int @NAME@_check(IntPtr memory);
        [DllImport(Library)] static extern long @NAME@_memory_size();
        [DllImport(Library)] static extern long @NAME@_file_size();

        const int Trust = @TRUST_INDEX@, HeaderSize = @HEADER_SIZE@, ToolSize = @TOOL_SIZE@;
        const int ToolForce = @FORCE_INDEX@, ToolPosition = @POSITION_INDEX@;
        IntPtr block, aligned;
        readonly double[] numbers = new double[7];

        public Organ(string path)
        {
            byte[] content = File.ReadAllBytes(path);
            long size = @NAME@_memory_size();
            if (content.LongLength != @NAME@_file_size())
                throw new InvalidDataException(path + " must be the file of this library; export the model again");
            block = Marshal.AllocHGlobal(new IntPtr(size + 64));
            aligned = new IntPtr((block.ToInt64() + 63) & ~63L);
            byte[] zeros = new byte[65536];
            for (long at = content.LongLength; at < size; at += zeros.Length)
                Marshal.Copy(zeros, 0, new IntPtr(memory.ToInt64() + at), (int)Math.Min(zeros.Length, size - at));
            Marshal.Copy(content, 0, memory, content.Length);
            if (@NAME@_check(memory) != 0)
            {
                Dispose();
                throw new InvalidDataException(path + " must be the file of this library; it is damaged or another");
            }
        }

        public void Dispose()
        {
            if (block != IntPtr.Zero) Marshal.FreeHGlobal(block);
            block = aligned = IntPtr.Zero;
            GC.SuppressFinalize(this);
        }

        ~Organ() { Dispose(); }

        // The memory of the model; after Dispose() there is none, and a call would write into that of others.
        IntPtr memory
        {
            get
            {
                if (block == IntPtr.Zero)
                    throw new ObjectDisposedException("@NAME@", "the model must not be used after Dispose(); make a new Organ");
                return aligned;
            }
        }

        // Request a pose of a tool, from 0, relative to the tool at rest.
        public void SetPose(int tool, double x, double y, double z, double w = 1, double i = 0, double j = 0, double k = 0)
        {
            var found = Find("pose");
            if (tool < 0 || tool >= found.rows) throw new ArgumentOutOfRangeException("tool");
            Marshal.Copy(new double[] { x, y, z, w, i, j, k }, 0, new IntPtr(found.place.ToInt64() + 56 * tool), 7);
        }

        // Take a period of 1 ms towards the requested poses; returns the status of palpate.h.
        public int Step() { return @NAME@_step(memory); }

        // Put a ball of a radius at a place in place of a tool; later poses are displacements from it.
        public int SetBall(int tool, double radius, double x, double y, double z, double friction = 0)
        {
            Marshal.WriteInt64(Find("tool_index").place, tool);
            Marshal.WriteInt64(Find("tool_kind").place, 0);
            Write("tool_sizes", radius, 0, 0);
            Write("tool_friction", friction);
            Write("tool_pose", x, y, z, 1, 0, 0, 0);
            return @NAME@_set_tool(memory);
        }

        public int Reset() { return @NAME@_reset(memory); }
        public double[] Force(int tool) { return Read("record", HeaderSize + ToolSize * tool + ToolForce, 3); }
        public double[] Position(int tool) { return Read("record", HeaderSize + ToolSize * tool + ToolPosition, 3); }
        public double TrustNumber { get { return Read("record", Trust, 1)[0]; } }
        public double ForceBound(int tool) { return Read("force_bound", tool, 1)[0]; }

        // Positions of the surface, three numbers a vertex.
        public float[] Vertices()
        {
            @NAME@_vertices(memory);
            var found = Find("vertices");
            var result = new float[3 * found.rows];
            Marshal.Copy(found.place, result, 0, result.Length);
            return result;
        }

        // Vertices of the triangles, counter-clockwise from outside (Unity: turn them, since it is left-handed).
        public int[] Triangles()
        {
            var found = Find("triangles");
            var result = new int[3 * found.rows];
            Marshal.Copy(found.place, result, 0, result.Length);
            return result;
        }

        (IntPtr place, int rows) Find(string name)
        {
            int count = Marshal.ReadInt32(memory, 12);
            byte[] text = new byte[24];
            for (int k = 0; k < count; k++)
            {
                IntPtr entry = new IntPtr(memory.ToInt64() + 64 + 48 * k);
                Marshal.Copy(entry, text, 0, 24);
                if (Encoding.ASCII.GetString(text).TrimEnd('\0') == name)
                    return (new IntPtr(memory.ToInt64() + Marshal.ReadInt64(entry, 24)), Marshal.ReadInt32(entry, 36));
            }
            throw new ArgumentException("no array " + name);
        }

        void Write(string name, params double[] values) { Marshal.Copy(values, 0, Find(name).place, values.Length); }

        double[] Read(string name, int first, int count)
        {
            var result = new double[count];
            Marshal.Copy(new IntPtr(Find(name).place.ToInt64() + 8 * first), result, 0, count);
            return result;
        }
    }
}
