// One character from C# through P/Invoke, as in a Unity script: Character.exe HOST:PORT
using System;
using System.Runtime.InteropServices;
using System.Text;

static class Motiongen
{
    const string Library = "motiongen_c";

    [StructLayout(LayoutKind.Sequential)]
    public struct Error
    {
        public uint StructSize;
        public int Code;
        [MarshalAs(UnmanagedType.ByValArray, SizeConst = 64)] public byte[] Reason;
        [MarshalAs(UnmanagedType.ByValArray, SizeConst = 512)] public byte[] Message;

        public static Error New()
        {
            return new Error { StructSize = (uint)Marshal.SizeOf(typeof(Error)), Reason = new byte[64], Message = new byte[512] };
        }

        public override string ToString()
        {
            int end = Array.IndexOf(Message, (byte)0);
            return Encoding.UTF8.GetString(Message, 0, end < 0 ? Message.Length : end);
        }
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct ClientOptions
    {
        public uint StructSize;
        public uint UseTls;
        [MarshalAs(UnmanagedType.LPUTF8Str)] public string Address;
        [MarshalAs(UnmanagedType.LPUTF8Str)] public string Token;
        [MarshalAs(UnmanagedType.LPUTF8Str)] public string RootCertificatesPem;
        public double ConnectTimeoutS;
        public uint NoReconnect;
        public uint Reserved;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct SessionOptions
    {
        public uint StructSize;
        public uint Priority;
        [MarshalAs(UnmanagedType.LPUTF8Str)] public string Prompt;
        [MarshalAs(UnmanagedType.LPUTF8Str)] public string ModelId;
        public ulong Seed;
        public uint HasSeed;
        public uint LookaheadFrames;
        public uint DenoiseSteps;
        public uint ManualClock;
        public float StartXM;
        public float StartZM;
        public float StartHeadingRad;
        public uint Reserved;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct Rig
    {
        public uint StructSize, NumJoints, RowFloats, FrameRateHz, RootColumn, RotationColumn, ContactColumn;
    }

    // Texts are UTF-8 in both directions. Marshal's "Ansi" cannot be used: on Windows it is the system's code page.
    public static string Text(IntPtr text)
    {
        int size = 0;
        while (Marshal.ReadByte(text, size) != 0) ++size;
        var bytes = new byte[size];
        Marshal.Copy(text, bytes, 0, size);
        return Encoding.UTF8.GetString(bytes);
    }

    [DllImport(Library)] public static extern uint motiongen_abi_version();
    [DllImport(Library)] public static extern int motiongen_client_connect(ref ClientOptions options, out IntPtr client, ref Error error);
    [DllImport(Library)] public static extern void motiongen_client_destroy(IntPtr client);
    [DllImport(Library)] public static extern int motiongen_client_open(IntPtr client, ref SessionOptions options, out IntPtr session, ref Error error);
    [DllImport(Library)] public static extern void motiongen_session_destroy(IntPtr session);
    [DllImport(Library)] public static extern int motiongen_session_wait_open(IntPtr session, double timeoutS, ref Error error);
    [DllImport(Library)] public static extern int motiongen_session_rig(IntPtr session, ref Rig rig, ref Error error);
    [DllImport(Library)] public static extern int motiongen_session_wait_frame(IntPtr session, ulong frame, double timeoutS, ref Error error);
    [DllImport(Library)] public static extern int motiongen_session_copy_frame(IntPtr session, ulong frame, float[] row, uint rowFloats, ref Error error);
    [DllImport(Library)] public static extern IntPtr motiongen_session_joint_name(IntPtr session, uint joint);
}

static class Program
{
    static Motiongen.Error error = Motiongen.Error.New();

    static void Check(int code)
    {
        if (code != 0) throw new InvalidOperationException(error.ToString());
    }

    static int Main(string[] arguments)
    {
        if (Motiongen.motiongen_abi_version() != 1) return 1;
        var options = new Motiongen.ClientOptions
        {
            StructSize = (uint)Marshal.SizeOf(typeof(Motiongen.ClientOptions)),
            Address = arguments.Length > 0 ? arguments[0] : "localhost:50051",
        };
        IntPtr client, walker;
        Check(Motiongen.motiongen_client_connect(ref options, out client, ref error));
        var character = new Motiongen.SessionOptions
        {
            StructSize = (uint)Marshal.SizeOf(typeof(Motiongen.SessionOptions)),
            Prompt = "a person walks forward",
        };
        Check(Motiongen.motiongen_client_open(client, ref character, out walker, ref error));
        Check(Motiongen.motiongen_session_wait_open(walker, 30, ref error));
        var rig = new Motiongen.Rig { StructSize = (uint)Marshal.SizeOf(typeof(Motiongen.Rig)) };
        Check(Motiongen.motiongen_session_rig(walker, ref rig, ref error));
        Console.WriteLine("{0} joints, the root is {1}", rig.NumJoints,
            Motiongen.Text(Motiongen.motiongen_session_joint_name(walker, 0)));
        var row = new float[rig.RowFloats];
        Check(Motiongen.motiongen_session_wait_frame(walker, 10, 30, ref error));
        Check(Motiongen.motiongen_session_copy_frame(walker, 10, row, rig.RowFloats, ref error));
        Console.WriteLine("frame 10: the hips are at {0:F2}, {1:F2}, {2:F2} m", row[0], row[1], row[2]);
        Motiongen.motiongen_session_destroy(walker);
        Motiongen.motiongen_client_destroy(client);
        return 0;
    }
}
